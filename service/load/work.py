"""The same frames without a service: the cost of decoding and tracking in one process, and the rates of lanes."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

from .clips import Clip
from .drive import quantile

WARM_FRAMES = 30
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
# Calls that wait for each lane, so that no lane is ever idle.
AHEAD = 3


@dataclass(frozen=True, slots=True)
class Work:
    """The cost of one frame in-process: median wall time and mean CPU time, in milliseconds."""

    frames: int
    wall_ms: float
    decode_ms: float
    cpu_ms: float


def in_process(clip: Clip, seconds: float) -> Work:
    """Decode what is needed of ``clip`` and track it for ``seconds``, in a new process that is set up as a lane is."""
    os.environ.update(dict.fromkeys(THREADS, "1"))  # before the child loads its libraries
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_in_process, clip, seconds).result()


def _in_process(clip: Clip, seconds: float) -> Work:
    from mfcmt_core import MFCMT
    from mfcmt_core.images import inspect
    from mfcmt_core.images.decode import decode, decode_part

    from ..lanes import preload  # noqa: F401  (threads, limits and kernels as in a lane)
    from .clips import LIMITS

    tracker = MFCMT()
    first, info = decode(clip.frame(0), LIMITS)
    tracker.init(first, clip.box)
    size = (info.width, info.height)
    wall, decoding = [], []
    cpu_start = start = 0.0
    index = 0
    while index <= WARM_FRAMES or time.perf_counter() - start < seconds:
        if index == WARM_FRAMES:
            start, cpu_start = time.perf_counter(), time.process_time()
        index += 1
        clock = time.perf_counter()
        data = clip.frame(index)
        image, offset = decode_part(data, inspect(data, LIMITS), tracker.needed_region())
        decoded = time.perf_counter()
        tracker.update(image, offset=offset, frame_size=size)
        if index > WARM_FRAMES:
            wall.append(time.perf_counter() - clock)
            decoding.append(decoded - clock)
    cpu = (time.process_time() - cpu_start) / len(wall)
    return Work(len(wall), quantile(wall, 0.5) * 1e3, quantile(decoding, 0.5) * 1e3, cpu * 1e3)


def lane_rates(clip: Clip, lanes: int, seconds: float) -> list[float]:
    """Return the frames/s of each of ``lanes`` lanes with one busy session each, without clients and front."""
    return asyncio.run(_lane_rates(clip, lanes, seconds))


async def _lane_rates(clip: Clip, count: int, seconds: float) -> list[float]:
    from ..app import local_lanes
    from ..lanes.interface import LaneReady
    from ..settings import Settings

    pool = local_lanes(Settings(lanes=count))
    await pool.start()
    try:
        events = pool.events()
        for _ in range(count):
            assert isinstance(await anext(events), LaneReady)
        keys = [f"lane-{number}" for number in range(count)]
        for key in keys:
            pool.reserve(key, "load")
        return list(await asyncio.gather(*(_busy(pool, key, clip, seconds) for key in keys)))
    finally:
        await pool.stop()


async def _busy(pool: Any, key: str, clip: Clip, seconds: float) -> float:
    from ..lanes.framing import decode_reply, encode_call

    options = {"preset": "default", "on_resize": "reject", "maps": False}
    create = encode_call("create", key, {"options": options, "boxes": [clip.box]}, clip.frame(0))
    code, said = decode_reply(await pool.call(key, create))
    assert code is None, said
    done = 0

    async def feed(first: int) -> None:
        nonlocal done
        index = first
        while time.perf_counter() < end:
            code, said = decode_reply(
                await pool.call(key, encode_call("track", key, {"seq": index}, clip.frame(index)))
            )
            assert code is None, said
            index += AHEAD
            done += 1

    start = time.perf_counter()
    end = start + seconds
    await asyncio.gather(*(feed(1 + ahead) for ahead in range(AHEAD)))
    return done / (time.perf_counter() - start)
