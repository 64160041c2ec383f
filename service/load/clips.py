"""Frames to send: a folder of images as they are, or brought to a size, or a rendered clip."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from mfcmt_core import synthetic
from mfcmt_core.cli import UsageError
from mfcmt_core.cli.boxes import parse_box
from mfcmt_core.images import FrameError, FrameLimits, inspect
from mfcmt_core.images.decode import decode
from mfcmt_core.images.files import list_images

Box = tuple[float, float, float, float]

IMAGES = {".jfif", ".jpe", ".jpeg", ".jpg", ".png", ".webp"}
JPEG_QUALITY = 80
LIMITS = FrameLimits()


@dataclass(frozen=True)
class Clip:
    """Encoded frames and the target's box in the first one."""

    name: str
    frames: list[bytes] = field(repr=False)
    box: Box

    @property
    def size(self) -> tuple[int, int]:
        """(w, h) of the first frame."""
        info = inspect(self.frames[0], LIMITS)
        return info.width, info.height

    def frame(self, index: int) -> bytes:
        """Return the frame at ``index``; past its end the clip runs backwards and then forwards again."""
        last = len(self.frames) - 1
        if last == 0:
            return self.frames[0]
        at = index % (2 * last)
        return self.frames[at if at <= last else 2 * last - at]

    def resized(self, size: tuple[int, int]) -> Clip:
        """Return the clip with frames of ``size`` (w, h), encoded again as JPEG."""
        if size == self.size:
            return self
        across, down = size[0] / self.size[0], size[1] / self.size[1]
        x, y, w, h = self.box
        frames = [encode(cv2.resize(decode(frame, LIMITS)[0], size)) for frame in self.frames]
        return replace(self, frames=frames, box=(x * across, y * down, w * across, h * down))


def encode(image: np.ndarray, quality: int = JPEG_QUALITY) -> bytes:
    """Return ``image`` as a JPEG, of quality 80 as cameras and browsers send."""
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return data.tobytes()


def open_clip(folder: Path | None, box: str | None, most: int = 1000) -> Clip:
    """Return the images of ``folder`` (of OTB: with ``img`` and a ground truth), or the rendered sample clip.

    Without ``box`` ("x,y,w,h") and ground truth the target is the middle of the frame. Raises UsageError.
    """
    if folder is None:
        clip = sample(min(most, 120))
        return clip if box is None else replace(clip, box=parse_box(box))
    files = images_of(folder)[:most]
    if not files:
        raise UsageError(f"no JPEG, PNG or WebP images in {folder}")
    frames = [file.read_bytes() for file in files]
    try:
        info = inspect(frames[0], LIMITS)
    except FrameError as bad:
        raise UsageError(f"{files[0]}: {bad.detail}") from bad
    if box is not None:
        start = parse_box(box)
    else:
        start = _ground_truth(folder) or (
            0.375 * info.width,
            0.375 * info.height,
            0.25 * info.width,
            0.25 * info.height,
        )
    return Clip(folder.name, frames, start)


def sample(length: int) -> Clip:
    """Return the first frames of the rendered VGA clip."""
    sequence = synthetic.clip("sample")
    x, y, w, h = map(float, sequence.boxes[0])
    return Clip("sample", [encode(sequence.frames[i]) for i in range(length)], (x, y, w, h))


def images_of(folder: Path) -> list[Path]:
    """The images in ``folder`` or its ``img``, in the order of their numbers."""
    return list_images(folder, IMAGES) or list_images(folder / "img", IMAGES)


def _ground_truth(folder: Path) -> Box | None:
    """The first box of OTB's ``groundtruth_rect.txt``, 0-based."""
    try:
        first = (folder / "groundtruth_rect.txt").read_text().split("\n", 1)[0]
        x, y, w, h = (float(v) for v in re.split(r"[,\s]+", first.strip()))
    except (OSError, ValueError):
        return None
    return x - 1, y - 1, w, h
