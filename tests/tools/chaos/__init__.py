"""``mfcmt chaos``: cause faults at random moments under load, and count what they cost."""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from mfcmt_core.cli.progress import Progress
from service.load.clips import Clip, open_clip

from ..command import Findings, add_json, check_range, finish
from .run import IDLE_S, RESTARTS, Plan, Report, chaos

if TYPE_CHECKING:
    from .cluster import ClusterReport

MAX_SESSIONS, MAX_FPS, MAX_FAULTS, MAX_FRAMES = 256, 120.0, 10_000, 300


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--faults", type=int, default=30, metavar="N", help="faults of lanes: SIGKILL, SIGSTOP, memory growth (30)")
    add("--restarts", type=int, default=3, metavar="N", help="then SIGTERMs of the service, and as many kill -9 (3)")
    add("--sessions", type=int, default=10, metavar="N", help="streams at once (10)")
    add("--fps", type=float, default=30.0, metavar="F", help="frames/s of each stream (30)")
    add("--lanes", type=int, default=2, metavar="N", help="lanes of the server that is started (2)")
    add("--seed", type=int, default=1, metavar="N", help="seed of the moments and the victims (1)")
    add("--cluster", action="store_true", help="try three nodes behind HAProxy that share a Redis, and their clients")
    add("--rounds", type=int, default=1, metavar="N", help="with --cluster: how often each fault is caused (1)")
    add("--frames", metavar="FOLDER", type=Path, help="images to send; default: a rendered clip")
    add("--box", metavar="X,Y,W,H", help="the target in the first frame; default: the ground truth, else the middle")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Return 0 if no result is missing or differs, else 1."""
    check_range("--faults", args.faults, 0, MAX_FAULTS)
    check_range("--restarts", args.restarts, 0, MAX_FAULTS)
    check_range("--sessions", args.sessions, 1, MAX_SESSIONS)
    check_range("--fps", args.fps, 1, MAX_FPS)
    check_range("--lanes", args.lanes, 1, MAX_SESSIONS)
    check_range("--rounds", args.rounds, 1, MAX_FAULTS)
    clip = open_clip(args.frames, args.box, MAX_FRAMES)
    if args.cluster:
        return _cluster(args, clip)
    plan = Plan(args.sessions, args.fps, args.lanes, args.faults, args.restarts, args.seed)

    def work() -> Findings:
        with Progress(args.faults + 2 * args.restarts + 1, "steps") as bar:
            report = chaos(clip, plan, bar.step)
        width, height = clip.size
        return Findings(lines(report, f"{clip.name}, {width}x{height}"), report.as_dict(), report.flawless)

    return finish("chaos", args.json, work)


def _cluster(args: argparse.Namespace, clip: Clip) -> int:
    from .cluster import FAULTS, ClusterPlan, cluster_chaos  # needs the tests' packages

    plan = ClusterPlan(args.sessions, args.fps, args.rounds, args.seed)

    def work() -> Findings:
        with Progress(len(FAULTS) * plan.rounds + 1, "steps") as bar:
            report = cluster_chaos(clip, plan, bar.step)
        return Findings(cluster_lines(report, clip.name), report.as_dict(), report.flawless)

    return finish("chaos", args.json, work)


def cluster_lines(report: ClusterReport, clip: str) -> Iterable[str]:
    """Return the report on a cluster as text."""
    plan = report.plan
    yield f"{plan.sessions} streams of {clip} by three nodes, {plan.fps:g} frames/s each, seed {plan.seed}"
    refused = "".join(f", {count} refused with {code}" for code, count in report.refused.items())
    yield f"results lost       {report.lost} of {report.frames}{refused}"
    yield f"results doubled    {report.doubled}"
    yield f"results that differ    {report.differ} of {report.compared} (those before a session forgot something)"
    yield f"sessions lost      {len(report.sessions_lost)}{''.join(f'; {error}' for error in report.sessions_lost)}"
    yield f"sessions that forgot   {report.forgotten}, each told with lost_after"
    for fault, seconds in report.pauses.items():
        yield f"{fault:<18} longest pause of a stream {max(seconds):.1f} s"


def lines(report: Report, clip: str) -> Iterable[str]:
    """Return the report as text."""
    plan = report.plan
    yield f"{plan.sessions} streams of {clip}, {plan.fps:g} frames/s each, {plan.lanes} lanes, seed {plan.seed}"
    counts = ", ".join(f"{count} {kind}" for kind, count in report.faults.items())
    yield f"faults injected    {counts}"
    refused = "".join(f", {count} refused with {code}" for code, count in report.refused.items())
    yield f"results lost       {report.lost} of {report.frames}{refused}"
    yield f"boxes that differ  {report.differ} of {report.compared} (those before the first kill -9 of the service)"
    for kind, seconds in report.seconds.items():
        what = "resumed" if kind in RESTARTS else "next result"
        yield (
            f"{f'{kind} to {what}':<24}median {statistics.median(seconds) * 1e3:6.0f} ms, max "
            f"{max(seconds) * 1e3:6.0f} ms, of {len(seconds)} streams hit"
        )
    if report.age_s:
        yield f"idle time          {IDLE_S:g} s; every session was {report.age_s:.0f} s old at the first restart"
    if report.forgotten:
        yield f"forgotten by kill -9    at most {max(report.forgotten)} frames of learning"
