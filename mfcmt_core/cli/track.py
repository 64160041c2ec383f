"""``mfcmt track``: follow boxes through a folder of images, a video or a camera."""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2

from ..config import PRESETS, MFCMTConfig
from ..errors import BadBox, DataError
from ..exports import FORMATS, SUFFIXES, Options, Target
from ..otb.catalogue import read_config
from ..video import VideoError
from ..video.write import check_target
from . import UsageError, add_batch
from .box_files import once_each, read_boxes
from .boxes import parse_box
from .follow import Task, follow, open_task
from .keyframes import follow_keyframes
from .many import is_many, track_many
from .progress import Progress
from .signals import Ended, Ending
from .targets import Start


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add(
        "source",
        metavar="SOURCE",
        help="images' folder, video, camera's number, stream's address, or folder of videos",
    )
    start = parser.add_mutually_exclusive_group(required=True)
    start.add_argument("--box", metavar="X,Y,W,H", help="the target in the first frame, in 0-based pixels")
    start.add_argument("--boxes", metavar="FILE", type=Path, help="CSV or JSON of boxes: x,y,w,h,name,class,frame,file")
    start.add_argument("--keyframes", metavar="FILE", type=Path, help="CSV or JSON of boxes known at several frames")
    start.add_argument("--select", action="store_true", help="draw the box in a page that opens in the browser")
    add("--no-browser", action="store_true", help="with --select: print the page's address only")
    add("--name", default="target", help="the target's name in the output (target)")
    add("--class", dest="kind", default="object", help="the target's class in the output (object)")
    add("--format", choices=FORMATS, help="default: by the output's suffix, or csv")
    add("--output", metavar="FILE", type=Path, help="write the boxes there (default: the standard output)")
    add("--tolerance", type=float, default=2.0, metavar="PX", help="cvat, labelstudio: thin out by so many pixels (2)")
    add("--video", metavar="FILE", type=Path, help="also write an annotated video (.mp4, .mov, .mkv, .webm, .avi)")
    add("--audio", action="store_true", help="with --video: with the sound of a source that is a video file")
    add("--fps", type=float, metavar="N", help="a folder's images a second, which gives them times")
    add("--for", dest="for_s", type=float, metavar="S", help="a camera or a stream: end after so many seconds")
    add("--retry", type=float, default=60.0, metavar="S", help="a stream that is gone: try for so long (60)")
    add_batch(parser, "a folder of videos: ")
    add(
        "--on-resize",
        choices=("reject", "rescale"),
        default="reject",
        help="what to do if the frames change their size: end, or start anew with the box scaled (reject)",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--preset", choices=PRESETS, default="default")
    which.add_argument("--config", metavar="FILE", help="TOML or JSON: fields of MFCMTConfig, and base, a preset")


def run(args: argparse.Namespace) -> int:
    """Track, write the results, and return the exit code."""
    if args.fps is not None and not 0 < args.fps <= 10000:
        raise UsageError("--fps is above 0")
    if not 0 <= args.tolerance < 1e6:
        raise UsageError("--tolerance is a number of pixels, 0 or more")
    if args.retry < 0 or (args.for_s is not None and args.for_s <= 0):
        raise UsageError("--for and --retry are numbers of seconds")
    starts = _starts(args)
    cv2.setNumThreads(1)  # more threads take processor time and are no faster
    if args.boxes and is_many(Path(args.source)):
        return track_many(args, starts, _config(args.preset, args.config))
    of_source = _of_source(args, starts)
    task = Task(
        args.source,
        tuple(of_source if args.keyframes else once_each(of_source, args.boxes)),
        _config(args.preset, args.config),
        _options(args, of_source),
        args.video,
        args.audio,
        args.on_resize == "rescale",
        args.fps,
        args.for_s,
        args.retry,
    )
    try:
        counts = _track(task, args)
    except Ended as ended:
        return ended.code
    except BrokenPipeError:  # the reader has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    if sys.stderr.isatty():
        print(", ".join(f"{n} {status}" for status, n in counts.items()), file=sys.stderr)
    return 0


def _track(task: Task, args: argparse.Namespace) -> Counter[str]:
    """Track one source, with a line that shows how far it is."""
    shown = task.options.output is not None or not sys.stdout.isatty()  # boxes on a terminal show the progress
    with Ending() as ending:
        source, first = open_task(task)
        if not task.starts:
            from .pick import pick_box

            box = pick_box(first.image, browser=not args.no_browser)
            task = replace(task, starts=(Start(Target(name=args.name, kind=args.kind), box),))
        with Progress(source.length, shown=shown) as bar:
            try:
                work = follow_keyframes if args.keyframes else follow
                return work(task, ending, lambda _, __, status: bar.step(status), source, first)
            except BadBox as bad:
                raise UsageError(str(bad)) from bad


def _starts(args: argparse.Namespace) -> dict[str, list[Start]]:
    """Return the targets by the file that they are in, ``""`` if that is the source."""
    if args.boxes is not None or args.keyframes is not None:
        return read_boxes(args.boxes or args.keyframes, args.name, args.kind)
    box = parse_box(args.box) if args.box is not None else None
    return {"": [] if box is None else [Start(Target(name=args.name, kind=args.kind), box)]}


def _of_source(args: argparse.Namespace, starts: dict[str, list[Start]]) -> list[Start]:
    """Return the targets of the one source."""
    path = Path(args.source)
    for name in ("", args.source, path.name, path.stem):
        if name in starts:
            return starts[name]
    raise UsageError(f"{args.boxes or args.keyframes} has no box for {path.name}")


def _options(args: argparse.Namespace, starts: list[Start]) -> Options:
    """Return how the boxes are written. Raises UsageError for outputs that cannot be."""
    output: Path | None = args.output
    if args.audio and (args.video is None or not Path(args.source).is_file()):
        raise UsageError("--audio needs --video, and a source that is a video file")
    style = args.format or SUFFIXES.get((output or Path()).suffix.lower(), "csv")
    if style == "yolo" and output is None:
        raise UsageError("--format yolo writes a folder: name it with --output")
    if style == "otb" and len(starts) > 1:
        raise UsageError("--format otb has one target; csv, jsonl, mot and others have several")
    for path in (output, args.video):
        if path is None:
            continue
        if not path.absolute().parent.is_dir():
            raise UsageError(f"no folder for {path}")
        if Path(args.source).exists() and path.exists() and _within(path, Path(args.source)):
            raise UsageError(f"{path} is the source, which would be overwritten")
    if args.video is not None:
        try:
            check_target(args.video)
        except VideoError as bad:
            raise UsageError(str(bad)) from bad
    if output is not None and args.video is not None and output.resolve() == args.video.resolve():
        raise UsageError(f"--output and --video are the same file, {output}")
    live = args.source.isdigit() or "://" in args.source
    if args.keyframes and live:
        raise UsageError("--keyframes are for files: a camera has no frame that is known beforehand")
    return Options(style, output, args.tolerance, bool(args.keyframes), flush=live)


def _within(path: Path, source: Path) -> bool:
    """Return True if a file is the source or one of the images of it."""
    from ..images.files import SUFFIXES as IMAGES

    if path.samefile(source):
        return True
    return source.is_dir() and path.suffix.lower() in IMAGES and path.parent.samefile(source)


def _config(preset: str, file: str | None) -> MFCMTConfig:
    if file is None:
        return MFCMTConfig.preset(preset)
    try:
        return read_config(Path(file))
    except DataError as bad:
        raise UsageError(str(bad)) from bad
