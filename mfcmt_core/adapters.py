"""The tracker behind the interfaces of other toolkits, none of which is imported."""

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
    """A drop-in for OpenCV's trackers, such as ``cv2.TrackerCSRT``: ``create()``, ``init()`` and ``update()``.

    It differs in two points on purpose: boxes may be floats and come back as floats, and while the target is lost
    the box is the last known one instead of zeros.
    """

    def __init__(self, config: MFCMTConfig | None = None) -> None:
        self.tracker = MFCMT(config)
        self._confidence = 0.0

    @classmethod
    def create(cls, config: MFCMTConfig | None = None) -> Self:
        """Return a tracker, as OpenCV's factories do. ``config`` takes the place of their ``Params``."""
        return cls(config)

    def init(self, image: Image, boundingBox: Iterable[float]) -> None:
        """Start on (x, y, w, h), 0-based pixels of a BGR or gray ``uint8`` image. Raises BadBox or BadImage."""
        self._confidence = self.tracker.init(image, boundingBox).confidence

    def update(self, image: Image) -> tuple[bool, Box]:
        """Return ``(ok, (x, y, w, h))``. ``ok`` is False while it is lost. Raises NotInitialised or BadImage."""
        result = self.tracker.update(image)
        self._confidence = result.confidence
        return result.status != "lost", result.box

    def getTrackingScore(self) -> float:
        """Return the confidence in the last box, as ``cv2.TrackerNano`` and ``cv2.TrackerVit`` do; 0 before a start."""
        return self._confidence


class Got10kTracker:
    """A tracker that the experiments of the got10k toolkit can run. It has the methods of their ``Tracker``.

    Images are ``PIL.Image`` or RGB arrays. The toolkit passes boxes as the annotation files have them. Those of OTB are
    1-based: ``origin=1`` subtracts 1 from given boxes and adds it to returned ones.
    """

    is_deterministic = True

    def __init__(self, config: MFCMTConfig | None = None, *, name: str = "MFCMT", origin: float = 0.0) -> None:
        self.name = name
        self.tracker = MFCMT(config)
        self._origin = np.array([origin, origin, 0, 0])

    def init(self, image: Any, box: npt.ArrayLike) -> None:
        """Start on ``box`` [x, y, w, h] of an RGB image. Raises BadBox or BadImage."""
        self.tracker.init(bgr(image), np.asarray(box, float) - self._origin)

    def update(self, image: Any) -> npt.NDArray[np.float64]:
        """Return the box [x, y, w, h] in the next RGB image, (4,) float64."""
        return self.tracker.update(bgr(image)).box + self._origin

    def track(
        self,
        img_files: Sequence[str | PathLike[str]],
        box: npt.ArrayLike,
        visualize: bool = False,  # noqa: ARG002 - the toolkit passes it; nothing is shown
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Track ``box`` through image files. Return boxes (N, 4), and seconds (N,) without reading and decoding."""
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
    """Return the box as one row [x1, y1, x2, y2], (1, 4) float32, as ``supervision.Detections`` takes it.

    Examples
    --------
    >>> from mfcmt_core import TrackResult
    >>> xyxy(TrackResult((10.0, 20.0, 30.0, 40.0), "tracking", None, None, None, None, True, 1.0)).tolist()
    [[10.0, 20.0, 40.0, 60.0]]
    """
    x, y, w, h = result.box
    return np.array([[x, y, x + w, y + h]], np.float32)


def bgr(image: Any) -> Image:
    """Return the image as BGR or gray ``uint8``. PIL resolves a palette or an alpha channel."""
    if getattr(image, "mode", "RGB") not in ("RGB", "L"):
        image = image.convert("RGB")
    pixels = np.asarray(image)
    return np.ascontiguousarray(pixels[..., ::-1]) if pixels.ndim == 3 else pixels
