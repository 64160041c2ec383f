"""Films whose frames tell their number, with times as awkward as those of real files."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

TICK = Fraction(1, 24_000)
SIZE = (320, 240)
BITS = 10  # of a frame's number, each a square at the bottom
BOX = (60, 60, 60, 60)


def picture(number: int) -> np.ndarray:
    """A textured square that moves to the right, and the number as black and white squares."""
    image = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
    image[::8] += 20
    x = BOX[0] + number % 120
    rows, columns = np.mgrid[: BOX[3], : BOX[2]]
    square = np.stack([(rows * 4) % 255, (columns * 4) % 255, (rows + columns) * 2 % 255], axis=2)
    image[BOX[1] : BOX[1] + BOX[3], x : x + BOX[2]] = square
    for bit in range(BITS):
        image[-24:, bit * 24 : (bit + 1) * 24] = 255 * (number >> bit & 1)
    return image


def number_of(image: np.ndarray) -> int:
    """The number that a picture tells, of whatever size it is."""
    h, w = image.shape[:2]
    y, step = round(h * (1 - 12 / SIZE[1])), 24 * w / SIZE[0]
    return sum((image[y, round((bit + 0.5) * step)].mean() > 128) << bit for bit in range(BITS))


def film(path: Path, times: list[float], codec: str = "libx264", **options: str) -> list[float]:
    """Write a film with a frame at each of ``times``, in seconds; returns the times as its container keeps them."""
    live = {"live": "1"} if options.pop("live", None) else {}
    with av.open(str(path), "w", options=live) as out:
        stream = out.add_stream(codec, rate=30, options={"g": "48", **options})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = TICK
        for number, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(picture(number), format="rgb24")
            frame.pts, frame.time_base = round(time / TICK), TICK
            out.mux(stream.encode(frame))
        out.mux(stream.encode())
    return times_of(path)


def times_of(path: Path) -> list[float]:
    """When each frame of a film is shown, in seconds."""
    with av.open(str(path)) as film:
        return [float(frame.pts * frame.time_base) for frame in film.decode(video=0) if frame.pts is not None]


def even(count: int, fps: float) -> list[float]:
    """Times of a film whose frames all last as long."""
    return [number / fps for number in range(count)]


def uneven(count: int) -> list[float]:
    """Times with long gaps and short ones, as of a film with frames left out."""
    lasts = (1 / 30, 1 / 30, 5 / 30, 1 / 30, 1 / 15, 1 / 60, 11 / 30)
    return [sum(lasts[i % len(lasts)] for i in range(number)) for number in range(count)]
