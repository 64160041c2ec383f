"""What a client saves that sends only the part of each frame that the trackers look at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mfcmt_core import MFCMT, synthetic

from ..frames.decode import Image, decode
from .clips import LIMITS, Clip, encode, images_of, open_clip
from .drive import quantile

LAG_FRAMES = 1
SMALL_TARGET_PX = 50.0


@dataclass(frozen=True, slots=True)
class Saving:
    """Bytes of the cut over bytes of the whole frame, both encoded alike: its distribution over frames."""

    name: str
    size: tuple[int, int]
    target: tuple[float, float]
    frames: int
    p10: float
    p50: float
    p90: float
    mean: float


def of_clip(clip: Clip, every: int) -> Saving:
    """The saving over ``clip``, weighed on each ``every``-th frame."""
    return _saving(clip.name, (decode(frame, LIMITS)[0] for frame in clip.frames), clip.box, every)


def of_sequences(root: Path, every: int, most: int) -> list[Saving]:
    """The saving over each folder of images in ``root``."""
    folders = sorted(folder for folder in root.iterdir() if folder.is_dir() and images_of(folder))
    return [of_clip(open_clip(folder, None, most), every) for folder in folders]


def of_small_target() -> Saving:
    """The saving for a target of 50 × 50 pixels in a rendered VGA clip."""
    sequence = synthetic.clip("sample", target=(SMALL_TARGET_PX, SMALL_TARGET_PX), zoom=1.0, length=120)
    x, y, w, h = map(float, sequence.boxes[0])
    return _saving("50 px at VGA", sequence.frames, (x, y, w, h), 1)


def _saving(name: str, images: Iterable[Image], box: tuple[float, float, float, float], every: int) -> Saving:
    ratios = list(_ratios(images, box, every))
    shares = [ratio for ratio, _ in ratios]
    size = ratios[0][1] if ratios else (0, 0)
    return Saving(
        name,
        size,
        (box[2], box[3]),
        len(shares),
        quantile(shares, 0.1),
        quantile(shares, 0.5),
        quantile(shares, 0.9),
        float(np.mean(shares)) if shares else float("nan"),
    )


def _ratios(
    images: Iterable[Image], box: tuple[float, float, float, float], every: int
) -> Iterator[tuple[float, tuple[int, int]]]:
    tracker = MFCMT()
    for index, image in enumerate(images):
        if index == 0:
            tracker.init(image, box)
            continue
        if index % every == 0:
            x, y, w, h = tracker.region(LAG_FRAMES)
            cut = len(encode(np.ascontiguousarray(image[y : y + h, x : x + w]))) if w and h else 0
            yield cut / len(encode(image)), (image.shape[1], image.shape[0])
        tracker.update(image)
