"""``mfcmt track``: follow a box through a folder of images, a video or a camera."""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import TextIO

import cv2

from ..config import PRESETS, MFCMTConfig
from ..errors import BadBox
from ..otb.catalogue import read_config
from ..otb.errors import DataError
from ..result import TrackResult
from ..tracker import MFCMT
from . import UsageError, formats
from .boxes import parse_box
from .media import Image, MediaError, Source, VideoFile, open_source
from .overlay import Overlay
from .progress import Progress


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("source", metavar="SOURCE", help="a folder of images, a video file or a camera's number")
    start = parser.add_mutually_exclusive_group(required=True)
    start.add_argument("--box", metavar="X,Y,W,H", help="the target in the first frame, in 0-based pixels")
    start.add_argument("--select", action="store_true", help="draw the box in a page that opens in the browser")
    parser.add_argument("--no-browser", action="store_true", help="with --select: print the page's address only")
    parser.add_argument("--format", choices=sorted(formats.FORMATS), help="default: by the output's suffix, or csv")
    parser.add_argument("--output", metavar="FILE", help="write the boxes there (default: the standard output)")
    parser.add_argument("--video", metavar="FILE", help="also write an annotated video (.mp4, .mkv, .avi, .webm)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--preset", choices=PRESETS, default="default")
    which.add_argument(
        "--config",
        metavar="FILE",
        help="TOML or JSON: fields of MFCMTConfig, and base, a preset",
    )


def run(args: argparse.Namespace) -> int:
    """Track, write the results, and return the exit code."""
    box = parse_box(args.box) if args.box is not None else None
    config = _config(args.preset, args.config)
    style = args.format or formats.SUFFIXES.get(Path(args.output or "").suffix.lower(), "csv")
    source = open_source(args.source)
    video = VideoFile(args.video, source.fps) if args.video else None
    if args.output and not Path(args.output).resolve().parent.is_dir():
        raise UsageError(f"no folder for {args.output}")
    cv2.setNumThreads(1)  # more threads take processor time and are no faster
    try:
        first = next(source.frames, None)
        if first is None:
            raise MediaError(f"no frames in {args.source}")
        if box is None:
            from .pick import pick_box

            box = pick_box(first, browser=not args.no_browser)
        tracker = MFCMT(config)
        try:
            start = tracker.init(first, box)
        except BadBox as bad:
            raise UsageError(f"box {','.join(f'{v:g}' for v in box)}: {bad.reason}") from bad
        counts = _follow(tracker, start, first, source, style, args.output, video)
    except MediaError as failed:
        print(f"mfcmt track: {failed}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    if sys.stderr.isatty():
        print(", ".join(f"{n} {status}" for status, n in counts.items()), file=sys.stderr)
    return 0


def _follow(
    tracker: MFCMT,
    start: TrackResult,
    first: Image,
    source: Source,
    style: str,
    output: str | None,
    video: VideoFile | None,
) -> Counter[str]:
    """Track to the end and write each result at once. Return the number of frames by status."""
    c = tracker.config
    overlay = Overlay((c.fused_threshold, c.template_threshold, c.statistical_threshold)) if video else None
    counts: Counter[str] = Counter()

    def results() -> Iterator[TrackResult]:
        try:
            for frame in chain([first], source.frames):
                result = start if frame is first else tracker.update(frame)
                if video and overlay:
                    video.write(overlay.draw(frame, result))
                yield result
        except KeyboardInterrupt:
            if not source.live:  # a camera ends only like this
                raise

    with ExitStack() as stack:
        if video:
            stack.callback(video.close)
        sink: TextIO = stack.enter_context(open(output, "w", newline="\n")) if output else sys.stdout
        shown = bool(output) or not sys.stdout.isatty()  # boxes on the same terminal show the progress
        bar = stack.enter_context(Progress(source.length, shown=shown))
        for result, text in formats.lines(style, results()):
            sink.write(text)
            if source.live:
                sink.flush()
            counts[result.status] += 1
            bar.step(result.status)
        sink.flush()
    return counts


def _config(preset: str, file: str | None) -> MFCMTConfig:
    if file is None:
        return MFCMTConfig.preset(preset)
    try:
        return read_config(Path(file))
    except DataError as bad:
        raise UsageError(str(bad)) from bad
