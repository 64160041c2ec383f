"""``mfcmt load``: drive a service with real frames and measure it."""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path

from mfcmt_core.cli import UsageError
from mfcmt_core.cli.measure import cpu_name
from mfcmt_core.cli.progress import Progress

from ..client import ClientError
from ..load import table
from ..load.clips import Clip, open_clip
from ..load.drive import Pace
from ..load.own import OwnServer, ServerFailed
from ..load.report import STEPS, measure
from ..load.run import Outcome, load, run_loop
from ..load.text import of_report, of_run
from .target import host_of

MAX_SESSIONS, MAX_FPS, MAX_SECONDS, MAX_FRAMES = 1024, 10_000.0, 3600.0, 300
LOOPBACK = {"127.0.0.1", "localhost", "::1"}
VGA = (640, 480)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add(
        "--frames",
        metavar="FOLDER",
        type=Path,
        help="images to send (also an OTB folder); default: a rendered clip",
    )
    add(
        "--box",
        metavar="X,Y,W,H",
        help="the target in the first frame; default: the ground truth, else the middle",
    )
    add("--size", metavar="WxH", help="encode the frames anew at this size; --report does it at 640x480")
    add("--sessions", type=int, default=1, metavar="N", help="sessions at once (1)")
    add(
        "--fps",
        type=float,
        default=30.0,
        metavar="F",
        help="frames/s of each; 0: as fast as answers come (30)",
    )
    add("--seconds", type=float, default=10.0, metavar="S", help="length of a run (10)")
    add("--mode", choices=("latest", "lossless"), help="default: latest, lossless with --fps 0")
    add(
        "--in-flight",
        type=int,
        metavar="N",
        help="unanswered frames with --fps 0; default: the server's credit",
    )
    add("--protocol", choices=("msgpack", "json"), default="msgpack", help="the subprotocol (msgpack)")
    add("--lanes", type=int, metavar="N", help="lanes of the server that is started; default: the cores")
    add("--url", help="drive this server instead of starting one")
    add("--key", help="its API key")
    add("--allow-remote", action="store_true", help="let --url name another machine")
    add("--report", action="store_true", help="measure the service's targets, all in one run (some minutes)")
    add("--table", action="store_true", help="measure what a frame costs by size, quality and targets, for sizing")
    add(
        "--sequences",
        metavar="ROOT",
        type=Path,
        help="with --report: folders of images, for what regions save",
    )
    add("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Do the work; the exit code."""
    _check(args)
    if args.table:
        return _table(args)
    clip = open_clip(args.frames, args.box, MAX_FRAMES)
    size = _size(args.size) or (VGA if args.report else None)
    if size:
        clip = clip.resized(size)
    try:
        if args.report:
            with Progress(STEPS, "steps") as bar:
                report = measure(clip, args.seconds, args.sequences, bar.begin)
            print(json.dumps(report.as_dict()) if args.json else of_report(report, clip))
            return 0 if all(target.met for target in report.targets) else 1
        outcome = _load(args, clip)
    except (ClientError, ServerFailed) as failed:
        print(f"mfcmt load: {failed}", file=sys.stderr)
        return 1
    print(json.dumps(outcome.as_dict()) if args.json else of_run(outcome))
    return 0


def _table(args: argparse.Namespace) -> int:
    try:
        with Progress(table.STEPS, "rows") as bar:
            rows = table.measure(args.seconds, bar.begin)
    except (ClientError, ServerFailed) as failed:
        print(f"mfcmt load: {failed}", file=sys.stderr)
        return 1
    machine = {"cpu": cpu_name(), "rows": [row.as_dict() for row in rows]}
    print(json.dumps(machine) if args.json else table.of_table(rows))
    return 0


def _load(args: argparse.Namespace, clip: Clip) -> Outcome:
    mode = args.mode or ("latest" if args.fps else "lossless")
    if mode == "latest" and not args.fps:
        raise UsageError("--mode latest needs --fps")
    pace = Pace(args.seconds, args.fps, mode, args.in_flight, f"mfcmt.v1.{args.protocol}")  # type: ignore[arg-type]
    paces = [pace] * args.sessions
    bar = Progress(args.seconds, "s", timed=True)
    if args.url:
        with bar:
            return run_loop(load(args.url, clip, paces, key=args.key))[0]
    settings = {} if args.lanes is None else {"lanes": args.lanes}
    with OwnServer(max_sessions_per_lane=args.sessions, **settings) as server, bar:
        return run_loop(load(server.url, clip, paces, front=server.pid))[0]


def _check(args: argparse.Namespace) -> None:
    for name, value, most in (
        ("--sessions", args.sessions, MAX_SESSIONS),
        ("--seconds", args.seconds, MAX_SECONDS),
        ("--in-flight", args.in_flight or 1, MAX_SESSIONS),
        ("--lanes", args.lanes or 1, MAX_SESSIONS),
    ):
        if not 0 < value <= most:
            raise UsageError(f"{name} is above 0 and at most {most:g}")
    if not 0 <= args.fps <= MAX_FPS:
        raise UsageError(f"--fps is from 0 to {MAX_FPS:g}")
    if args.url:
        host = host_of(args.url, args.key)
        if host not in LOOPBACK and not args.allow_remote:
            raise UsageError(f"{host} is another machine; --allow-remote if that is meant")
        if args.report or args.table or args.lanes:
            raise UsageError("--report, --table and --lanes start a server of their own; leave out --url")
    if args.table and (args.report or args.frames or args.size or args.box):
        raise UsageError("--table renders its own frames and goes with neither --report, --frames, --size nor --box")


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    if not (match := re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)):
        raise UsageError("--size takes WxH, as 640x480")
    return int(match[1]), int(match[2])
