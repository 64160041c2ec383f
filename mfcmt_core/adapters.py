"""The tracker behind the interfaces of other toolkits. None of them is imported: shape is enough."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .errors import BadImage
from .geometry import Image
from .images.files import BadImageFile, read_image
from .result import Box, TrackResult
from .tracker import MFCMT


class OpenCVTracker:
    """In place of ``cv2.TrackerCSRT``: ``create()``, ``init(image, box)``, ``update(image)``.

    Two differences, both wanted: boxes may be floats and come back as floats, and while the target is lost
    the box is the last known one instead of zeros.
    """

    def __init__(self, config: MFCMTConfig | None = None) -> None:
        self.tracker = MFCMT(config)

    @classmethod
    def create(cls, config: MFCMTConfig | None = None) -> Self:
        """As OpenCV's factories; ``config`` takes the place of their ``Params``."""
        return cls(config)

    def init(self, image: Image, boundingBox: Iterable[float]) -> None:
        """Start on (x, y, w, h), 0-based px of a BGR or grey ``uint8`` image. Raises BadBox, BadImage."""
        self.tracker.init(image, boundingBox)

    def update(self, image: Image) -> tuple[bool, Box]:
        """``(ok, (x, y, w, h))``; not ``ok`` while the target is lost. Raises NotInitialised, BadImage."""
        result = self.tracker.update(image)
        return result.status != "lost", result.box


class Got10kTracker:
    """What the got10k toolkit's experiments run: its ``Tracker`` in shape, not by inheritance.

    Images are ``PIL.Image`` (or RGB arrays). The toolkit hands out boxes as the annotation files have them:
    1-based for OTB, for which ``origin=1`` takes 1 off on the way in and adds it on the way out.
    """

    is_deterministic = True

    def __init__(self, config: MFCMTConfig | None = None, *, name: str = "MFCMT", origin: float = 0.0) -> None:
        self.name = name
        self.tracker = MFCMT(config)
        self._origin = np.array([origin, origin, 0, 0])

    def init(self, image: Any, box: npt.ArrayLike) -> None:
        """Start on ``box`` [x, y, w, h] of an RGB image. Raises BadBox, BadImage."""
        self.tracker.init(_bgr(image), np.asarray(box, float) - self._origin)

    def update(self, image: Any) -> npt.NDArray[np.float64]:
        """The box [x, y, w, h] in the next RGB image, (4,)."""
        return self.tracker.update(_bgr(image)).box + self._origin

    def track(
        self,
        img_files: Sequence[str | PathLike[str]],
        box: npt.ArrayLike,
        visualize: bool = False,  # noqa: ARG002 - the toolkit passes it; nothing is shown
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Follow ``box`` through files: boxes (N, 4), and seconds (N,) without reading and decoding."""
        boxes, seconds = np.empty((len(img_files), 4)), np.empty(len(img_files))
        for i, path in enumerate(img_files):
            try:
                frame = read_image(Path(path), turned=False)
            except BadImageFile as bad:
                raise BadImage(str(bad)) from bad
            start = time.perf_counter()
            result = self.tracker.update(frame) if i else self.tracker.init(frame, box - self._origin)
            seconds[i] = time.perf_counter() - start
            boxes[i] = result.box + self._origin
        return boxes, seconds


def xyxy(result: TrackResult) -> npt.NDArray[np.float32]:
    """The box as one row [x1, y1, x2, y2], (1, 4): ``supervision.Detections(xyxy=xyxy(result))``."""
    x, y, w, h = result.box
    return np.array([[x, y, x + w, y + h]], np.float32)


def _bgr(image: Any) -> Image:
    """Grey stays grey; RGB is turned round; a palette or alpha is resolved by PIL."""
    if getattr(image, "mode", "RGB") not in ("RGB", "L"):
        image = image.convert("RGB")
    pixels = np.asarray(image)
    return np.ascontiguousarray(pixels[..., ::-1]) if pixels.ndim == 3 else pixels
