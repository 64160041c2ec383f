"""``mfcmt soak``: work for a long time and check that memory stays flat."""

from __future__ import annotations

import argparse

from mfcmt_core.cli import UsageError
from mfcmt_core.cli.progress import Progress
from service.load.clips import sample
from service.load.own import OwnServer
from service.load.run import run_loop

from ..command import Findings, add_json, check_range, finish
from .run import Phase, lines, settings, soak_frames, soak_sessions

SESSIONS, FRAMES = 100_000, 1_000_000
SHORT_SESSIONS, SHORT_FRAMES = 3000, 24_000
LEAST, MOST = 300, 10_000_000
SIZE = (96, 72)
CLIP_FRAMES = 30


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--sessions", type=int, metavar="N", help=f"sessions to open and close ({SESSIONS:,}); 0: none")
    add("--frames", type=int, metavar="N", help=f"frames to track ({FRAMES:,}); 0: none")
    add("--short", action="store_true", help=f"{SHORT_SESSIONS:,} sessions and {SHORT_FRAMES:,} frames")
    add("--streams", type=int, default=8, metavar="N", help="sessions that share the frames (8)")
    add("--lanes", type=int, default=2, metavar="N", help="lanes of the server that is started (2)")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Return 0 if memory stays flat and nothing fails, else 1."""
    usual = (SHORT_SESSIONS, SHORT_FRAMES) if args.short else (SESSIONS, FRAMES)
    sessions = usual[0] if args.sessions is None else args.sessions
    frames = usual[1] if args.frames is None else args.frames
    for name, value in (("--sessions", sessions), ("--frames", frames)):
        if value and not LEAST <= value <= MOST:
            raise UsageError(f"{name} is 0 or from {LEAST} to {MOST}")
    check_range("--streams", args.streams, 1, 32)
    check_range("--lanes", args.lanes, 1, 32)

    def work() -> Findings:
        phases = _soak(sessions, frames, args.streams, args.lanes)
        return Findings(lines(phases), [phase.as_dict() for phase in phases], all(phase.flat for phase in phases))

    return finish("soak", args.json, work)


def _soak(sessions: int, frames: int, streams: int, lanes: int) -> list[Phase]:
    clip = sample(CLIP_FRAMES).resized(SIZE)
    phases = []
    with OwnServer(lanes=lanes, **settings(sessions, frames, streams)) as server:
        if sessions:
            with Progress(sessions, "sessions") as bar:
                phases.append(run_loop(soak_sessions(server.url, server.pid, clip, sessions, bar.step)))
        if frames:
            with Progress(frames, "frames") as bar:
                phases.append(run_loop(soak_frames(server.url, server.pid, clip, frames, streams, bar.step)))
    return phases
