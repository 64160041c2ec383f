"""The bytes that a client saves by sending only the needed region of each frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mfcmt_core import MFCMT, synthetic
from mfcmt_core.images.decode import decode

from .clips import LIMITS, Clip, encode, images_of, open_clip
from .drive import quantile

LAG_FRAMES = 1
VGA = (640, 480)
SMALL_TARGET_PX = (45.0, 55.0)


@dataclass(frozen=True, slots=True)
class Saving:
    """The distribution over frames of: bytes of the region over bytes of the whole frame, both encoded alike."""

    name: str
    size: tuple[int, int]
    target_px: float
    frames: int
    p10: float
    p50: float
    p90: float
    mean: float


def savings(clips: Iterable[Clip], every: int) -> list[Saving]:
    """The saving over each clip at VGA, and first over all frames together whose target is small there.

    Each ``every``-th frame is weighed. ``target_px`` is the mean root of the target's area.
    """
    savings, small = [], []
    for clip in clips:
        frames = list(_shares(clip.resized(VGA), every))
        savings.append(_saving(clip.name, frames))
        small += [frame for frame in frames if SMALL_TARGET_PX[0] <= frame[0] <= SMALL_TARGET_PX[1]]
    return [_saving("small targets", small), *savings]


def clips_in(root: Path, most: int) -> Iterator[Clip]:
    """Return the first ``most`` frames of each folder of images in ``root``."""
    for folder in sorted(root.iterdir()):
        if folder.is_dir() and images_of(folder):
            yield open_clip(folder, None, most)


def small_target_clip(length: int) -> Clip:
    """Return a rendered VGA clip with a target of 50 × 50 pixels."""
    sequence = synthetic.clip("sample", target=(50.0, 50.0), zoom=1.0, length=length)
    x, y, w, h = map(float, sequence.boxes[0])
    return Clip("rendered", [encode(frame) for frame in sequence.frames], (x, y, w, h))


def _shares(clip: Clip, every: int) -> Iterator[tuple[float, float]]:
    """Return the root of the target's area, and the next region's share of the frame's bytes."""
    tracker = MFCMT()
    _, _, width, height = clip.box
    for index, frame in enumerate(clip.frames):
        image, _ = decode(frame, LIMITS)
        if index and index % every == 0:
            x, y, w, h = tracker.region(LAG_FRAMES)
            cut = encode(np.ascontiguousarray(image[y : y + h, x : x + w]))
            yield math.sqrt(width * height), len(cut) / len(encode(image))
        _, _, width, height = (tracker.update(image) if index else tracker.init(image, clip.box)).box


def _saving(name: str, frames: list[tuple[float, float]]) -> Saving:
    sides, shares = [side for side, _ in frames], [share for _, share in frames]
    p10, p50, p90 = (quantile(shares, share) for share in (0.1, 0.5, 0.9))
    count = max(1, len(frames))
    return Saving(name, VGA, sum(sides) / count, len(frames), p10, p50, p90, sum(shares) / count)
