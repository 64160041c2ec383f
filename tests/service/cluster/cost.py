"""What several nodes cost: ``python -m tests.service.cluster.cost`` (``--nodes`` for the throughput besides).

The time that a call takes at the node that has the session and through another one, in turns; and the bytes that Redis
gets of a stream at 30 frames/s with the default settings.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import time
from collections.abc import AsyncIterator
from contextlib import ExitStack

import httpx2
import redis

from service.client import AsyncClient
from service.lanes.usage import cpu_s
from service.load.clips import Clip, open_clip, sample
from service.load.own import OwnServer
from tests.conftest import OTB_ROOT

from .nodes import KEY, create, node
from .redis_server import RedisServer

CALLS, WARM = 2000, 200
STREAMS, FPS, FOR_S = 4, 30, 20
DEFAULTS = {"checkpoint_every_frames": 30, "store_every_s": 5.0}


async def call_ms(first: OwnServer, second: OwnServer, clip: Clip) -> tuple[list[float], list[float]]:
    """Milliseconds of GET at the owner and through another node, one after the other."""
    sid = await create(first, clip)
    direct, passed = [], []
    async with AsyncExit(first, second) as (here, there):
        for number in range(WARM + CALLS):
            for bare, times in ((here, direct), (there, passed)):
                begun = time.perf_counter()
                answer = await bare.get(f"/v1/sessions/{sid}")
                if number >= WARM:
                    times.append((time.perf_counter() - begun) * 1e3)
                assert answer.status_code == 200
    return direct, passed


class AsyncExit:
    """Bare HTTP clients of two servers."""

    def __init__(self, *servers: OwnServer) -> None:
        self._clients = [httpx2.AsyncClient(base_url=one.url, headers={"X-API-Key": KEY}) for one in servers]

    async def __aenter__(self) -> list[httpx2.AsyncClient]:
        return self._clients

    async def __aexit__(self, *_: object) -> None:
        for each in self._clients:
            await each.aclose()


async def stream(server: OwnServer, clip: Clip, for_s: float, fps: float | None) -> int:
    """Return how many frames of a stream are answered; without ``fps`` as many as go."""
    end = time.monotonic() + for_s

    async def frames() -> AsyncIterator[bytes]:
        due, index = time.monotonic(), 1
        while time.monotonic() < end:
            if fps:
                due += 1 / fps
                await asyncio.sleep(max(0.0, due - time.monotonic()))
            yield clip.frame(index)
            index += 1

    done = 0
    async with AsyncClient(server.url, key=KEY) as there, await there.create(clip.frames[0], clip.box) as session:
        async for _ in session.stream(frames(), mode="lossless"):
            done += 1
    return done


async def bytes_per_stream(server: OwnServer, clip: Clip, store: RedisServer) -> float:
    """Return the bytes a second that Redis gets of one stream."""
    with redis.Redis(port=store.port) as watcher:
        before = watcher.info()["total_net_input_bytes"]
        begun = time.monotonic()
        await asyncio.gather(*(stream(server, clip, FOR_S, FPS) for _ in range(STREAMS)))
        return (watcher.info()["total_net_input_bytes"] - before) / (time.monotonic() - begun) / STREAMS


async def rate(servers: list[OwnServer], clip: Clip, streams: int, for_s: float) -> float:
    """Return the frames a second of all servers together."""
    done = await asyncio.gather(*(stream(servers[i % len(servers)], clip, for_s, None) for i in range(streams)))
    return sum(done) / for_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", action="store_true", help="also compare two nodes of one lane with one of two")
    chosen = parser.parse_args()
    david = OTB_ROOT / "David"
    clip = open_clip(david, None, 60) if david.is_dir() else sample(60)
    with ExitStack() as stack:
        store = stack.enter_context(RedisServer())
        first, second = (stack.enter_context(node(name, store, **DEFAULTS)) for name in ("a", "b"))
        used = cpu_s(second.pid)
        direct, passed = asyncio.run(call_ms(first, second, clip))
        used = cpu_s(second.pid) - used
        near, far = statistics.median(direct), statistics.median(passed)
        print(f"GET of a session, p50 of {CALLS}: {near:.2f} ms at its node, {far:.2f} ms through another")
        print(f"added by the other node: {far - near:.2f} ms, of its processor {used / (WARM + CALLS) * 1e3:.2f} ms")
        per_s = asyncio.run(bytes_per_stream(first, clip, store))
        print(f"Redis gets {per_s / 1e6:.3f} MB/s of a stream at {FPS} frames/s; of 100 streams {per_s / 1e4:.1f} MB/s")
        if chosen.nodes:
            one = stack.enter_context(node("c", store, lanes=2, **DEFAULTS))
            for _ in range(2):
                both = asyncio.run(rate([first, second], clip, 4, 10))
                alone = asyncio.run(rate([one], clip, 4, 10))
                print(f"frames/s: {both:.0f} of two nodes with a lane each, {alone:.0f} of one node with two lanes")


if __name__ == "__main__":
    main()
