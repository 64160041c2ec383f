"""Opens sessions and tracks frames over real sockets for long, and measures the memory that remains."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from service.client import AsyncClient, ConnectionLost, Frame, Problem, Ready, Result
from service.client.connection import Connection
from service.load.clips import Clip
from service.load.usage import server_processes, usage

from ..command import Tell
from .slope import WARM_UP, Slope, slope

SAMPLES = 80
# One of so many sessions gets a stream before it is closed, to show memory that streams leave behind.
STREAM_EVERY = 10
OPENERS = 4
FRAMES_IN_FLIGHT = 4
# Lower bounds of what the service remembers, so that they are reached within the warm-up.
SETTINGS: dict[str, Any] = {"log_level": "warning", "max_sessions_per_lane": 32}
MAX_REMEMBERED = 10_000
# A tracked frame in a trajectory, at the least.
ENTRY_BYTES = 200
MAX_TRAJECTORY_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Phase:
    """``done`` units (``session`` or ``frame``) in ``seconds``; the slope of each role's private memory."""

    unit: str
    done: int
    seconds: float
    failed: int
    slopes: dict[str, Slope]

    @property
    def flat(self) -> bool:
        """Whether nothing failed and no role grows."""
        return not self.failed and all(one.flat for one in self.slopes.values())

    def as_dict(self) -> dict[str, Any]:
        return asdict(self) | {"flat": self.flat}


class MemoryMeter:
    """Private memory of the front and of all lanes together, read as work goes on."""

    def __init__(self, front: int, total: int, tell: Tell) -> None:
        self._processes = server_processes(front)
        self._every = max(1, total // SAMPLES)
        self._tell, self._note = tell, ""
        self._done: list[float] = []
        self._used: dict[str, list[float]] = {"front": [], "lanes": []}

    def count(self, done: int) -> None:
        """``done`` units are done."""
        self._tell(self._note)
        if done % self._every:
            return
        used = {role: usage(pid).private_bytes for role, pid in self._processes.items()}
        self._done.append(done)
        self._used["front"].append(used["front"])
        self._used["lanes"].append(sum(size for role, size in used.items() if role.startswith("lane")))
        self._note = ", ".join(f"{role} {sizes[-1] / 1e6:.1f} MB" for role, sizes in self._used.items())

    def slopes(self) -> dict[str, Slope]:
        """The slope of each role."""
        return {role: slope(self._done, used) for role, used in self._used.items()}


def settings(sessions: int, frames: int, streams: int) -> dict[str, Any]:
    """Bounds of the server that are reached within the warm-up, and never above the defaults."""
    remembered = min(MAX_REMEMBERED, max(1, int(WARM_UP * sessions / 2))) if sessions else MAX_REMEMBERED
    trajectory = int(WARM_UP * frames / streams / 2) * ENTRY_BYTES if frames else MAX_TRAJECTORY_BYTES
    return SETTINGS | {
        "max_tombstones": remembered,
        "max_idempotency_keys": remembered,
        "max_trajectory_bytes": min(MAX_TRAJECTORY_BYTES, max(4096, trajectory)),
    }


async def soak_sessions(url: str, front: int, clip: Clip, total: int, tell: Tell) -> Phase:
    """Open and close ``total`` sessions, a few at a time."""
    meter, left, done, failed = MemoryMeter(front, total, tell), total, 0, 0
    start = time.monotonic()

    async def open_and_close(client: AsyncClient) -> None:
        nonlocal left, done, failed
        while left:
            left -= 1
            try:
                session = await client.create(clip.frame(0), clip.box)
                if left % STREAM_EVERY == 0:
                    await _stream(client, session.id, clip, 1)
                await session.close()
            except (Problem, ConnectionLost):
                failed += 1
            done += 1
            meter.count(done)

    async with AsyncClient(url) as client:
        await asyncio.gather(*(open_and_close(client) for _ in range(OPENERS)))
    return Phase("session", done, time.monotonic() - start, failed, meter.slopes())


async def soak_frames(url: str, front: int, clip: Clip, total: int, streams: int, tell: Tell) -> Phase:
    """Have ``total`` frames tracked by ``streams`` sessions at once."""
    meter, done, failed = MemoryMeter(front, total, tell), 0, 0
    start = time.monotonic()

    def tracked() -> None:
        nonlocal done
        done += 1
        meter.count(done)

    async def run(client: AsyncClient, frames: int) -> None:
        nonlocal failed
        session = await client.create(clip.frame(0), clip.box)
        failed += frames - await _stream(client, session.id, clip, frames, tracked)
        await session.close()

    shares = [total // streams + (n < total % streams) for n in range(streams)]
    async with AsyncClient(url) as client:
        await asyncio.gather(*(run(client, share) for share in shares))
    return Phase("frame", done, time.monotonic() - start, failed, meter.slopes())


async def _stream(
    client: AsyncClient, sid: str, clip: Clip, frames: int, tracked: Callable[[], None] | None = None
) -> int:
    """Stream ``frames``; how many were answered with a result."""
    connection = await Connection.open(client.address, sid, mode="lossless", protocol="mfcmt.v1.msgpack")
    try:
        ready = await connection.receive()
        if not isinstance(ready, Ready):
            raise ready if isinstance(ready, Problem) else ConnectionLost("the stream began without ready")
        room = min(FRAMES_IN_FLIGHT, ready.credit or FRAMES_IN_FLIGHT)
        sent = answered = results = 0
        while answered < frames:
            while sent < frames and sent - answered < room:
                sent += 1
                await connection.send_frame(Frame(clip.frame(sent)))
            message = await connection.receive()
            answered += isinstance(message, Result | Problem)
            if isinstance(message, Result):
                results += 1
                if tracked is not None:
                    tracked()
        return results
    finally:
        await connection.close()


def lines(phases: Sequence[Phase]) -> Iterable[str]:
    """Return the phases as text."""
    for phase in phases:
        rate = phase.done / phase.seconds
        what = "opened and closed" if phase.unit == "session" else "tracked"
        yield f"{phase.done:,} {phase.unit}s {what} in {phase.seconds:.0f} s ({rate:.0f}/s), {phase.failed} failed"
        for role, one in phase.slopes.items():
            yield (
                f"  {role:<6}{one.first / 1e6:8.2f} MB after warm-up, {one.last / 1e6:.2f} MB at the end: "
                f"{one.per_unit:+.2f} ± {one.noise:.2f} bytes a {phase.unit}, {'flat' if one.flat else 'GROWS'}"
            )
