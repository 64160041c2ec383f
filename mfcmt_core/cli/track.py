"""``mfcmt track``: follow boxes through a folder of images, a video or a camera."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import cv2

from ..config import PRESETS, MFCMTConfig
from ..errors import BadBox, MFCMTError
from ..exports import FORMATS, SUFFIXES, Options, Target
from ..otb.catalogue import read_config
from ..otb.errors import DataError
from ..video import VideoError
from ..video.write import check_target
from . import UsageError
from .boxes import parse_box
from .follow import Job, follow
from .media import open_source
from .signals import Ended, Ending
from .targets import Start


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("source", metavar="SOURCE", help="a folder of images, a video file or a camera's number")
    start = parser.add_mutually_exclusive_group(required=True)
    start.add_argument("--box", metavar="X,Y,W,H", help="the target in the first frame, in 0-based pixels")
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
    box = parse_box(args.box) if args.box is not None else None
    if args.fps is not None and not 0 < args.fps <= 10000:
        raise UsageError("--fps is above 0")
    if not 0 <= args.tolerance < 1e6:
        raise UsageError("--tolerance is a number of pixels, 0 or more")
    config = _config(args.preset, args.config)
    options = _options(args)
    cv2.setNumThreads(1)  # more threads take processor time and are no faster
    with Ending() as ending:
        try:
            source = open_source(args.source, args.fps)
            first = next(source.frames, None)
            if first is None:
                raise MFCMTError(f"no frames in {args.source}")
            if box is None:
                from .pick import pick_box

                box = pick_box(first.image, browser=not args.no_browser)
            starts = [Start(Target(name=args.name, kind=args.kind), box)]
            rescale = args.on_resize == "rescale"
            job = Job(source, first, starts, config, options, args.video, args.audio, rescale)
            counts = follow(job, ending)
        except BadBox as bad:
            raise UsageError(str(bad)) from bad
        except Ended as ended:
            return ended.code
        except BrokenPipeError:  # the reader has closed the pipe
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
    if sys.stderr.isatty():
        print(", ".join(f"{n} {status}" for status, n in counts.items()), file=sys.stderr)
    return 0


def _options(args: argparse.Namespace) -> Options:
    """Return how the boxes are written. Raises UsageError for outputs that cannot be."""
    output: Path | None = args.output
    if args.audio and (args.video is None or not Path(args.source).is_file()):
        raise UsageError("--audio needs --video, and a source that is a video file")
    style = args.format or SUFFIXES.get((output or Path()).suffix.lower(), "csv")
    if style == "yolo" and output is None:
        raise UsageError("--format yolo writes a folder: name it with --output")
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
    return Options(style, output, args.tolerance)


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
