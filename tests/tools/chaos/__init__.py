"""``mfcmt chaos``: cause faults at random moments under load, and count what they cost."""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterable
from pathlib import Path

from mfcmt_core.cli.progress import Progress
from service.load.clips import open_clip

from ..command import Findings, add_json, check_range, finish
from .run import IDLE_S, RESTARTS, Plan, Report, chaos

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
    clip = open_clip(args.frames, args.box, MAX_FRAMES)
    plan = Plan(args.sessions, args.fps, args.lanes, args.faults, args.restarts, args.seed)

    def work() -> Findings:
        with Progress(args.faults + 2 * args.restarts + 1, "steps") as bar:
            report = chaos(clip, plan, bar.step)
        width, height = clip.size
        return Findings(lines(report, f"{clip.name}, {width}x{height}"), report.as_dict(), report.flawless)

    return finish("chaos", args.json, work)


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
