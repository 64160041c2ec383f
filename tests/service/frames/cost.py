"""What a whole frame costs its lane: ``python -m tests.service.frames.cost``.

Milliseconds of processor time of the operation ``track`` on whole JPEG frames with a target of 100 px, by size: with
every pixel decoded, as before there were excerpts, and as it is. Both sessions take each frame in turn, so that the
ratio holds on a busy machine; their results must be equal.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict

from mfcmt_core import synthetic
from mfcmt_core.images import FrameInfo, FrameLimits
from mfcmt_core.images.decode import Image, decode_inspected
from service.lanes import lane_session, preload  # noqa: F401  (threads, limits and kernels as in a lane)
from service.lanes.limits import LaneLimits
from service.lanes.operations import LaneOperations
from service.lanes.rows import Rect
from service.load.clips import encode
from service.protocol.requests import Options

SIZES = {"VGA": (640, 480), "720p": (1280, 720), "1080p": (1920, 1080), "4K": (3840, 2160)}
MOST = {"VGA": 0.8, "720p": 0.55, "1080p": 0.55, "4K": 0.45}
FRAMES, TARGET = 60, (100.0, 100.0)


@contextmanager
def every_pixel() -> Iterator[None]:
    """Decode whole frames meanwhile."""

    def decode_all(data: bytes, info: FrameInfo, needed: Rect) -> tuple[Image, tuple[int, int]]:
        return decode_inspected(data, info), (0, 0)

    shipped = lane_session.decode_part
    lane_session.decode_part = decode_all
    try:
        yield
    finally:
        lane_session.decode_part = shipped


def measure(size: tuple[int, int]) -> tuple[int, float, float]:
    """The median bytes of a frame, and the milliseconds of a frame with every pixel decoded and as it is."""
    clip = synthetic.clip("motion", size=size, target=TARGET, length=FRAMES)
    frames = [encode(image) for image in clip.frames]
    lane = LaneOperations(LaneLimits(FrameLimits(), 10, 1))
    for key in ("before", "after"):
        lane.handle(
            "create", key, {"options": asdict(Options()), "boxes": [list(map(float, clip.boxes[0]))]}, frames[0]
        )
    before, after = [], []
    for seq, frame in enumerate(frames[1:], 1):
        with every_pixel():
            begun = time.thread_time()
            expected = lane.handle("track", "before", {"seq": seq}, frame)
            before.append(time.thread_time() - begun)
        begun = time.thread_time()
        found = lane.handle("track", "after", {"seq": seq}, frame)
        after.append(time.thread_time() - begun)
        assert found["rows"] == expected["rows"]
    size_bytes = round(statistics.median(map(len, frames)))
    return size_bytes, statistics.median(before) * 1e3, statistics.median(after) * 1e3


def main() -> None:
    """Print them."""
    print(f"{'frame':<8}{'kB':>8}{'every pixel':>14}{'as it is':>12}{'ratio':>8}{'at most':>10}")
    for name, size in SIZES.items():
        size_bytes, before, after = measure(size)
        ratio = after / before
        print(f"{name:<8}{size_bytes / 1e3:8.0f}{before:14.2f}{after:12.2f}{ratio:8.2f}{MOST[name]:10.2f}")


if __name__ == "__main__":
    main()
