"""``mfcmt soak``: work for long and see that memory stays flat."""

from __future__ import annotations

import argparse
import json
import sys

from mfcmt_core.cli import UsageError
from mfcmt_core.cli.progress import Progress

from ..client import ClientError
from ..load.clips import sample
from ..load.own import OwnServer, ServerFailed
from ..load.run import run_loop
from ..load.soak import Phase, settings, soak_frames, soak_sessions, text

SESSIONS, FRAMES = 100_000, 1_000_000
SHORT_SESSIONS, SHORT_FRAMES = 3000, 24_000
LEAST = 300
MOST = 10_000_000
SIZE = (96, 72)
CLIP_FRAMES = 30


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--sessions", type=int, metavar="N", help=f"sessions to open and close ({SESSIONS:,}); 0: none")
    add("--frames", type=int, metavar="N", help=f"frames to track ({FRAMES:,}); 0: none")
    add("--short", action="store_true", help=f"{SHORT_SESSIONS:,} sessions and {SHORT_FRAMES:,} frames")
    add("--streams", type=int, default=8, metavar="N", help="sessions that the frames are shared among (8)")
    add("--lanes", type=int, default=2, metavar="N", help="lanes of the server that is started (2)")
    add("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """0 if memory stays flat and nothing fails, else 1."""
    usual = (SHORT_SESSIONS, SHORT_FRAMES) if args.short else (SESSIONS, FRAMES)
    sessions, frames = (
        chosen if asked is None else asked for asked, chosen in zip((args.sessions, args.frames), usual, strict=True)
    )
    for name, value in (("--sessions", sessions), ("--frames", frames)):
        if value and not LEAST <= value <= MOST:
            raise UsageError(f"{name} is 0 or from {LEAST} to {MOST}")
    if not 1 <= args.streams <= 32 or not 1 <= args.lanes <= 32:
        raise UsageError("--streams and --lanes are from 1 to 32")
    try:
        phases = _soak(args, sessions, frames)
    except (ClientError, ServerFailed) as failed:
        print(f"mfcmt soak: {failed}", file=sys.stderr)
        return 1
    print(json.dumps([phase.as_dict() for phase in phases]) if args.json else text(phases))
    return 0 if all(phase.flat for phase in phases) else 1


def _soak(args: argparse.Namespace, sessions: int, frames: int) -> list[Phase]:
    clip = sample(CLIP_FRAMES).resized(SIZE)

    phases = []
    with OwnServer(lanes=args.lanes, **settings(sessions, frames, args.streams)) as server:
        if sessions:
            with Progress(sessions, "sessions") as bar:
                phases.append(run_loop(soak_sessions(server.url, server.pid, clip, sessions, bar.step)))
        if frames:
            with Progress(frames, "frames") as bar:
                phases.append(run_loop(soak_frames(server.url, server.pid, clip, frames, args.streams, bar.step)))
    return phases
