"""``mfcmt demo --terminal``: stream a clip through a service and print what comes back."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from mfcmt_core.cli import UsageError
from mfcmt_core.cli.boxes import parse_box
from mfcmt_core.cli.media import open_source
from mfcmt_core.errors import MFCMTError

from ..client import Client, ClientError, Frame, Result
from ..load.clips import Box, encode, open_clip
from ..load.drive import quantile
from ..load.own import OwnServer, ServerFailed
from .target import host_of

MAX_FPS = 1000.0
SAMPLE_FPS = 30.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument_group("with --terminal").add_argument
    add("source", nargs="?", metavar="SOURCE", help="a folder of images or a video; default: a rendered clip")
    add(
        "--box",
        metavar="X,Y,W,H",
        help="the target in the first frame; default: the ground truth, else the middle",
    )
    add("--fps", type=float, metavar="F", help="frames/s; default: the video's, else 30")
    add("--frames", type=int, default=300, metavar="N", help="number of frames at most (300)")
    add(
        "--mode",
        choices=("latest", "lossless"),
        default="latest",
        help="drop late frames, or answer all (latest)",
    )
    add("--url", help="a running service; default: one of its own")
    add("--key", help="its API key")


def run(args: argparse.Namespace) -> int:
    """Do the work; the exit code."""
    if args.frames < 2:
        raise UsageError("--frames is at least 2")
    if args.fps is not None and not 0 < args.fps <= MAX_FPS:
        raise UsageError(f"--fps is above 0 and at most {MAX_FPS:g}")
    if args.url:
        host_of(args.url, args.key)
    # On a terminal each result takes the place of the one before.
    before, after = ("\r\x1b[K", "") if sys.stdout.isatty() else ("", "\n")
    try:
        first, frames, box, fps = _open(args)
        with ExitStack() as stack:
            url = args.url or stack.enter_context(OwnServer(lanes=1)).url
            client = stack.enter_context(Client(url, key=args.key))
            session = stack.enter_context(client.create(first, box))
            width, height = session.info.size
            print(f"{url}/v1/sessions/{session.id}: {width}x{height}, box {_box(box)}")
            tally = _Tally()
            stream = stack.enter_context(session.stream(_paced(frames, args.fps or fps), mode=args.mode))
            for result in stream:
                print(f"{before}{tally.line(result)}", end=after, flush=True)
            print(f"{before}{tally.summary()}")
    except (ClientError, ServerFailed, MFCMTError) as failed:
        print(f"mfcmt demo: {failed}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # whoever reads the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _open(args: argparse.Namespace) -> tuple[bytes, Iterator[bytes], Box, float]:
    """Return the first frame, the others, the box, and the rate in frames/s."""
    if args.source is None or Path(args.source).is_dir():
        clip = open_clip(None if args.source is None else Path(args.source), args.box, args.frames)
        return clip.frames[0], iter(clip.frames[1:]), clip.box, SAMPLE_FPS
    source = open_source(args.source)
    first = next(source.frames, None)
    if first is None:
        raise MFCMTError(f"no frames in {args.source}")
    height, width = first.image.shape[:2]
    box = parse_box(args.box) if args.box else (0.375 * width, 0.375 * height, 0.25 * width, 0.25 * height)
    rest = (encode(frame.image) for frame, _ in zip(source.frames, range(args.frames - 1), strict=False))
    return encode(first.image), rest, box, source.fps


def _paced(frames: Iterator[bytes], fps: float) -> Iterator[Frame]:
    """Yield ``frames`` at ``fps``, each with the time of its sending."""
    start = time.perf_counter()
    for index, data in enumerate(frames):
        time.sleep(max(0.0, start + index / fps - time.perf_counter()))
        yield Frame(data, ts=time.perf_counter())


class _Tally:
    """Counts the results."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._latency_ms: list[float] = []
        self._status: Counter[str] = Counter()
        self._dropped = 0

    def line(self, result: Result) -> str:
        """Count a result and return its line."""
        latency_ms = (time.perf_counter() - float(result.ts or 0)) * 1e3
        target, timing = result.target, result.timing
        self._latency_ms.append(latency_ms)
        self._status[target.status] += 1
        self._dropped += result.dropped
        flags = target.flags
        passed = (
            "-"
            if flags is None
            else "".join(
                letter if good else "."
                for letter, good in zip("FTS", (flags.fused, flags.template, flags.statistical), strict=True)
            )
        )
        work = f"{timing.decode_ms + timing.track_ms:.1f}" if timing else "-"
        return (
            f"frame {result.seq:4d}  box {_box(target.box)}  {target.status:<9} {passed:<3} "
            f"{latency_ms:5.1f} ms round trip, {work} in the lane, {result.dropped} dropped"
        )

    def summary(self) -> str:
        """Return the line that sums up all results."""
        seconds = time.perf_counter() - self._start
        statuses = ", ".join(f"{count} {status}" for status, count in self._status.most_common())
        p50, p95 = (quantile(self._latency_ms, share) for share in (0.5, 0.95))
        return (
            f"{len(self._latency_ms)} results in {seconds:.1f} s ({statuses}; {self._dropped} dropped), "
            f"round trip p50 {p50:.1f} ms, p95 {p95:.1f} ms"
        )


def _box(box: Box) -> str:
    return " ".join(f"{value:6.1f}" for value in box)
