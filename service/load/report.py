"""The targets of the service, ratios that are measured in one run on the same frames."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..client import AsyncClient
from .clips import Clip
from .drive import Pace
from .own import OwnServer
from .regions import Saving, clips_in, savings, small_target_clip
from .run import Outcome, load, run_loop
from .usage import MB, Usage, server_usage
from .work import Work, in_process, lane_rates

STEPS = 11
"""Number of steps of :func:`measure`, which reports each when it begins."""
MEMORY_SESSIONS = 16
NEIGHBOUR_FPS = 30.0
REGION_FRAMES, REGION_EVERY = 300, 5


@dataclass(frozen=True, slots=True)
class Goal:
    """A measured figure and its target: at most, or at least, ``limit``."""

    name: str
    measured: float
    limit: float
    unit: str
    at_least: bool = False

    @property
    def met(self) -> bool:
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit


@dataclass(slots=True)
class Report:
    """All targets, and the measurements behind them."""

    targets: list[Goal] = field(default_factory=list)
    work: list[Work] = field(default_factory=list)
    runs: dict[str, Outcome] = field(default_factory=dict)
    at_rest: dict[str, Usage] = field(default_factory=dict)
    after_load: dict[str, Usage] = field(default_factory=dict)
    lane_rates: dict[str, list[float]] = field(default_factory=dict)
    savings: list[Saving] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        report = asdict(self)
        for target, one in zip(report["targets"], self.targets, strict=True):
            target["met"] = one.met
        return report


def measure(clip: Clip, seconds: float, sequences: Path | None, say: Callable[[str], None]) -> Report:
    """Measure everything in turn. A run takes ``seconds``; ``say`` is called with the name of each step."""
    report = Report()
    say("in-process work")
    report.work.append(in_process(clip, seconds))
    with OwnServer() as server:
        report.at_rest = server_usage(server.pid)
        say("one session, one frame in flight")
        report.runs["unloaded"] = _load(server, clip, Pace(seconds, in_flight=1))
        say("one session, as fast as it goes")
        report.runs["saturated"] = _load(server, clip, Pace(seconds))
        rate = 2 * report.runs["saturated"].fps
        say(f"latest mode at {rate:.0f} frames/s, twice what one session sustains")
        report.runs["overload"] = _load(server, clip, Pace(seconds, fps=rate, mode="latest"))
        report.after_load = server_usage(server.pid)
    with OwnServer(lanes=1) as server:
        say("memory of sessions")
        session_mb = run_loop(_session_bytes(server, clip)) / MB
        say("a session at 30 frames/s, alone")
        steady = Pace(seconds, fps=NEIGHBOUR_FPS, mode="latest")
        report.runs["alone"] = _load(server, clip, steady)
        say("the same beside a flooding client in the same lane")
        flood = Pace(seconds, fps=2 * report.runs["saturated"].fps, mode="latest")
        report.runs["beside"], report.runs["flood"] = _load_all(server, clip, [steady, flood])
    say("in-process work again")
    report.work.append(in_process(clip, seconds))
    for lanes in (1, 2):
        say(f"{lanes} lane(s) without a front")
        report.lane_rates[str(lanes)] = lane_rates(clip, lanes, seconds)
    say("regions")
    clips = clips_in(sequences, REGION_FRAMES) if sequences else [clip, small_target_clip(REGION_FRAMES)]
    report.savings = savings(clips, REGION_EVERY)
    report.targets = _targets(report, session_mb)
    return report


def _targets(report: Report, session_mb: float) -> list[Goal]:
    wall_ms = sum(work.wall_ms for work in report.work) / len(report.work)
    cpu_ms = sum(work.cpu_ms for work in report.work) / len(report.work)
    runs = report.runs
    one, two = (sum(report.lane_rates[lanes]) for lanes in ("1", "2"))
    return [
        Goal("CPU a frame, service over in-process", runs["saturated"].cpu_ms / cpu_ms, 1.35, "x"),
        Goal("round trip p50 beyond the work, unloaded", runs["unloaded"].p50_ms - wall_ms, 0.6, "ms"),
        Goal("throughput of two lanes over one", two / one, 1.7, "x", at_least=True),
        Goal("p95 at twice the sustainable rate, over the work", runs["overload"].p95_ms / wall_ms, 2.5, "x"),
        Goal("p95 beside a flood, over alone", runs["beside"].p95_ms / runs["alone"].p95_ms, 2.0, "x"),
        Goal("memory of a session in its lane", session_mb, 4.0, "MB"),
        Goal("bytes of a region, 50 px at VGA", report.savings[0].p50, 0.2, "x"),
    ]


def _load(server: OwnServer, clip: Clip, pace: Pace) -> Outcome:
    return _load_all(server, clip, [pace])[0]


def _load_all(server: OwnServer, clip: Clip, paces: list[Pace]) -> list[Outcome]:
    return run_loop(load(server.url, clip, paces, front=server.pid))


async def _session_bytes(server: OwnServer, clip: Clip) -> float:
    """Return the memory that one more session adds to its lane: the slope between one session and all."""
    async with AsyncExitStack() as stack:
        client = await stack.enter_async_context(AsyncClient(server.url))

        async def one_more() -> None:
            session = await stack.enter_async_context(await client.create(clip.frame(0), clip.box))
            for index in range(1, 4):
                await session.track(clip.frame(index))

        await one_more()
        before = server_usage(server.pid)["lane 0"]
        for _ in range(MEMORY_SESSIONS - 1):
            await one_more()
        after = server_usage(server.pid)["lane 0"]
    return (after.private_bytes - before.private_bytes) / (MEMORY_SESSIONS - 1)
