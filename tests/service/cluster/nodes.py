"""Nodes as processes that share a Redis."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from service.client import AsyncClient, AsyncSession, Frame, Result, Resumed
from service.load.clips import Clip
from service.load.own import OwnServer, free_port
from tests.conftest import ROOT

from .redis_server import RedisServer

KEY = "a-key-of-all-the-nodes-0123456789"
PACE_S = 0.04


def node(name: str, store: RedisServer, **settings: object) -> OwnServer:
    """Return a node that has not started."""
    port = free_port()
    given: dict[str, object] = {
        "lanes": 1,
        "api_keys": KEY,
        "signing_keys": "the-same-for-all-nodes-0123456789",
        "store": store.url,
        "node": name,
        "node_url": f"http://127.0.0.1:{port}",
        "operation_deadline_s": 60,
        "checkpoint_every_frames": 4,
        "store_every_s": 0.2,
    }
    return OwnServer(port=port, **given | settings)


def led(text: str, nodes: list[OwnServer]) -> str:
    """Return the text of a proxy's example, changed to lead to these nodes."""
    for number, node in enumerate(nodes, 1):
        assert f"127.0.0.1:800{number}" in text
        text = text.replace(f"127.0.0.1:800{number}", f"127.0.0.1:{node.port}")
    return text


def haproxy(folder: Path, port: int, nodes: list[OwnServer]) -> list[str]:
    """Return the command of the HAProxy of docker/cluster before these nodes."""
    text = led((ROOT / "docker/cluster/haproxy.cfg").read_text(), nodes)
    (folder / "haproxy.cfg").write_text(text.replace("bind :8080", f"bind 127.0.0.1:{port}"))
    return ["haproxy", "-db", "-f", f"{folder}/haproxy.cfg"]


def client(server: OwnServer) -> AsyncClient:
    return AsyncClient(server.url, key=KEY, ping_interval_s=3)


async def create(server: OwnServer, clip: Clip, **more: Any) -> str:
    """Make a session at a node, and return its id."""
    async with client(server) as there:
        return (await there.create(clip.frames[0], clip.box, **more)).id


async def paced(frames: list[bytes], go_on: asyncio.Event, held: int) -> AsyncIterator[Frame]:
    """Yield frames at a steady pace, ``ts`` their place; after the first ``held`` ones, wait for ``go_on``."""
    for number, frame in enumerate(frames):
        if number == held:
            await go_on.wait()
        await asyncio.sleep(PACE_S)
        yield Frame(frame, ts=number)


class Run:
    """A lossless stream whose results are kept; ``halfway`` is set when ``held`` results are there."""

    def __init__(self, session: AsyncSession, frames: list[bytes], held: int) -> None:
        self.results: list[Result] = []
        self.resumed: list[Resumed] = []
        self.halfway, self._go_on = asyncio.Event(), asyncio.Event()
        self._held = held
        self._frames = paced(frames, self._go_on, held)
        self._task = asyncio.create_task(self._run(session))

    async def _run(self, session: AsyncSession) -> None:
        async with session.stream(self._frames, mode="lossless", on_resumed=self.resumed.append) as stream:
            async for result in stream:
                self.results.append(result)
                if len(self.results) == self._held:
                    self.halfway.set()

    async def finish(self) -> list[int]:
        """Let the rest of the frames go, and return the places of the frames whose results came."""
        self._go_on.set()
        await self._task
        return [int(result.ts or 0) for result in self.results]


def kill(server: OwnServer, signal_: signal.Signals = signal.SIGKILL) -> None:
    os.kill(server.pid, signal_)
