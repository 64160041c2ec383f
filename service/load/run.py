"""A run: sessions at a rate, with the figures of their clients and of the server's processes."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

from ..client import AsyncClient
from .clips import Clip
from .drive import Pace, Tally, drive, quantile
from .usage import Usage, cpu_between, server_usage

R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Outcome:
    """The figures of a run; CPU time and memory are known of a server on this machine alone."""

    sessions: int
    seconds: float
    sent: int
    answered: int
    dropped: int
    refused: dict[str, int]
    fps: float
    p50_ms: float
    p95_ms: float
    p99_ms: float
    queue_p50_ms: float
    decode_p50_ms: float
    track_p50_ms: float
    mbit_per_s: float
    front_cpu_ms: float | None
    lanes_cpu_ms: float | None
    before: dict[str, Usage] | None
    after: dict[str, Usage] | None

    @property
    def cpu_ms(self) -> float:
        """The CPU time of the whole service per answered frame."""
        return (self.front_cpu_ms or 0.0) + (self.lanes_cpu_ms or 0.0)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def run_loop(work: Coroutine[Any, Any, R]) -> R:
    """``asyncio.run`` on uvloop where it is installed: the client's share of a round trip is smaller."""
    new_loop: Callable[[], asyncio.AbstractEventLoop] = asyncio.new_event_loop
    with suppress(ImportError):
        from uvloop import new_event_loop as new_loop
    with asyncio.Runner(loop_factory=new_loop) as runner:
        return runner.run(work)


async def load(
    url: str, clip: Clip, paces: Sequence[Pace], *, key: str | None = None, front: int | None = None
) -> list[Outcome]:
    """Drive a session at each of ``paces`` at once. Return one outcome if all paces are equal, else one for each.

    ``front`` is the process id of the server's front, where it runs on this machine.
    """
    async with AsyncExitStack() as stack:
        client = await stack.enter_async_context(AsyncClient(url, key=key))
        sessions = [await stack.enter_async_context(await client.create(clip.frame(0), clip.box)) for _ in paces]
        before = server_usage(front) if front is not None else None
        tallies = await asyncio.gather(
            *(drive(client, session, clip, pace) for session, pace in zip(sessions, paces, strict=True))
        )
        after = server_usage(front) if front is not None else None
    if len(tallies) == 1 or len(set(paces)) == 1:
        return [_outcome(tallies, before, after)]
    return [_outcome([tally], None, None) for tally in tallies]  # their CPU time cannot be separated


def _outcome(tallies: Sequence[Tally], before: dict[str, Usage] | None, after: dict[str, Usage] | None) -> Outcome:
    round_trips = [ms for tally in tallies for ms in tally.round_trips_ms]
    seconds = max(tally.seconds for tally in tallies)
    answered = len(round_trips)
    cpu = cpu_between(before, after) if before and after else None
    refused: Counter[str] = Counter()
    for tally in tallies:
        refused.update(tally.refused)

    def median(name: str) -> float:
        return quantile([ms for tally in tallies for ms in getattr(tally, name)], 0.5)

    return Outcome(
        sessions=len(tallies),
        seconds=seconds,
        sent=sum(tally.sent for tally in tallies),
        answered=answered,
        dropped=sum(tally.dropped for tally in tallies),
        refused=dict(refused),
        fps=answered / seconds,
        p50_ms=quantile(round_trips, 0.5),
        p95_ms=quantile(round_trips, 0.95),
        p99_ms=quantile(round_trips, 0.99),
        queue_p50_ms=median("queue_ms"),
        decode_p50_ms=median("decode_ms"),
        track_p50_ms=median("track_ms"),
        mbit_per_s=sum(tally.sent_bytes for tally in tallies) * 8e-6 / seconds,
        front_cpu_ms=cpu["front"] / answered * 1e3 if cpu and answered else None,
        lanes_cpu_ms=cpu["lanes"] / answered * 1e3 if cpu and answered else None,
        before=before,
        after=after,
    )
