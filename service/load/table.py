"""A table for sizing: what a frame costs by size, quality, targets and way of sending, and what bounds its rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass

import numpy as np

from mfcmt_core import synthetic
from mfcmt_core.cli.measure import cpu_name
from mfcmt_core.geometry import Image

from ..client import AsyncClient
from .clips import Box, encode
from .drive import quantile
from .own import OwnServer
from .run import run_loop
from .usage import cpu_between, server_usage

SIZES = {"320×240": (320, 240), "640×480": (640, 480), "1280×720": (1280, 720), "1920×1080": (1920, 1080)}
SIZES |= {"3840×2160": (3840, 2160)}
QUALITIES = (60, 75, 90)
MIDDLE = 75
TARGETS = 10
FPS = 30.0
FRAMES = 8
"""Frames of a row, which are sent forwards and backwards."""
WARM_FRAMES = 16


@dataclass(frozen=True, slots=True)
class Kind:
    """What a row measures: whole frames or regions, the quality of their JPEGs, and the number of targets."""

    regions: bool
    quality: int
    targets: int


KINDS = (
    *(Kind(False, quality, 1) for quality in QUALITIES),
    Kind(False, MIDDLE, TARGETS),
    Kind(True, MIDDLE, 1),
    Kind(True, MIDDLE, TARGETS),
)
STEPS = len(SIZES) * len(KINDS)
"""Number of rows of :func:`measure`, which reports each when it begins."""


@dataclass(frozen=True, slots=True)
class Row:
    """A measured row: bytes of a frame, and milliseconds of processor time of the front and of the lane.

    ``decode_ms`` and ``track_ms`` are the medians of wall time in the lane.
    """

    size: str
    kind: Kind
    frame_bytes: float
    front_ms: float
    lane_ms: float
    decode_ms: float
    track_ms: float

    @property
    def streams(self) -> float:
        """Streams at 30 frames/s for which one core has time, front and lane together."""
        return 1e3 / FPS / (self.front_ms + self.lane_ms)

    @property
    def bound(self) -> str:
        """What takes the most time."""
        times = {"front": self.front_ms, "decode": self.decode_ms, "track": self.track_ms}
        return max(times, key=times.__getitem__)

    def as_dict(self) -> dict[str, object]:
        return asdict(self) | {"streams": self.streams, "bound": self.bound}


def measure(seconds: float, say: Callable[[str], None]) -> list[Row]:
    """Return the rows, each measured for ``seconds`` with one stream and one lane of a server of its own."""
    rows = []
    with OwnServer(lanes=1) as server:
        for name, size in SIZES.items():
            images, box = _scene(size)
            for kind in KINDS:
                say(f"{name}, {_told(kind)}")
                rows.append(run_loop(_row(server, name, images, box, kind, seconds)))
    return rows


def of_table(rows: Iterable[Row]) -> str:
    """Return the rows as a table in Markdown, under the processor's name."""
    lines = [
        f"{cpu_name()}; milliseconds of processor time a frame, streams at {FPS:.0f} frames/s in one core",
        "",
        "| frame | sent | kB | front | lane | streams | bound by |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        times = f"{row.frame_bytes / 1e3:.0f} | {row.front_ms:.2f} | {row.lane_ms:.2f} | {row.streams:.0f}"
        lines.append(f"| {row.size} | {_told(row.kind)} | {times} | {row.bound} |")
    return "\n".join(lines)


def _told(kind: Kind) -> str:
    what = "regions" if kind.regions else "whole"
    return f"{what}, quality {kind.quality}, {kind.targets} target{'s' if kind.targets > 1 else ''}"


def _scene(size: tuple[int, int]) -> tuple[list[Image], Box]:
    """Return the images and the target in the first one: 100 pixels a side, or a fifth of the frame's height."""
    side = min(100.0, size[1] / 5)
    clip = synthetic.clip("motion", size=size, target=(side, side))
    x, y, w, h = map(float, clip.boxes[0])
    return clip.frames[:FRAMES], (x, y, w, h)


async def _row(server: OwnServer, name: str, images: list[Image], box: Box, kind: Kind, seconds: float) -> Row:
    jpegs = [encode(image, kind.quality) for image in images]
    sent: list[int] = []

    def part(index: int, region: tuple[int, int, int, int] | None) -> bytes:
        x, y, w, h = region or (0, 0, 0, 0)
        cut = images[index][y : y + h, x : x + w]
        whole = not (kind.regions and region)
        data = jpegs[index] if whole else encode(np.ascontiguousarray(cut), kind.quality)
        sent.append(len(data))
        return data

    async with AsyncClient(server.url) as client, await client.create(jpegs[0], boxes=_boxes(box, kind)) as session:
        async for _ in session.stream(_order(WARM_FRAMES), mode="lossless", encode=part):
            pass
        sent.clear()
        before = server_usage(server.pid)
        stream = session.stream(_until(time.monotonic() + seconds), mode="lossless", encode=part)
        timings = [result.timing async for result in stream]
        cpu = cpu_between(before, server_usage(server.pid))
    known = [timing for timing in timings if timing is not None]
    return Row(
        size=name,
        kind=kind,
        frame_bytes=quantile(sent, 0.5),
        front_ms=cpu["front"] / len(timings) * 1e3,
        lane_ms=cpu["lanes"] / len(timings) * 1e3,
        decode_ms=quantile([timing.decode_ms for timing in known], 0.5),
        track_ms=quantile([timing.track_ms for timing in known], 0.5),
    )


def _boxes(box: Box, kind: Kind) -> list[Box]:
    """Return the boxes of the targets: all show the same, a few pixels apart."""
    x, y, w, h = box
    return [(x + k % 5 * 3 - 6, y + k // 5 * 3 - 1, w, h) if k else box for k in range(kind.targets)]


def _order(count: int) -> Iterator[int]:
    """Yield the indices of ``count`` frames, forwards from the second one and backwards in turn."""
    last = FRAMES - 1
    for number in range(1, count + 1):
        at = number % (2 * last)
        yield at if at <= last else 2 * last - at


def _until(end: float) -> Iterator[int]:
    for index in _order(1 << 62):
        if time.monotonic() >= end:
            return
        yield index
