"""Trackers of other libraries, for comparison: those of OpenCV, NanoTrack among them, and dlib's correlation tracker.

CSRT, KCF and MOSSE need ``opencv-contrib-python-headless`` (which replaces the plain wheel), and dlib's tracker
``dlib``, so they live in an environment of their own. NanoTrack, a small network, needs its two files:
``MFCMT_NANOTRACK`` names their folder.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from ..geometry import Image
from ..result import Box

_cv: Any = cv2  # the type stubs of the plain wheel do not know the contrib trackers
NANOTRACK = "MFCMT_NANOTRACK"
NANOTRACK_FILES = ("nanotrack_backbone_sim.onnx", "nanotrack_head_sim.onnx")


class OpenCVPeer:
    """A tracker of OpenCV. Where it reports a miss the previous box stands, since OpenCV gives none then."""

    def __init__(self, create: Callable[[], Any]) -> None:
        self._tracker = create()
        self._box: Box = (0.0, 0.0, 0.0, 0.0)
        self.found = True

    @property
    def confidence(self) -> float:
        """Return its score if it has one, else 1 if it reports that the target is found and 0 if not."""
        score = getattr(self._tracker, "getTrackingScore", None)
        return float(score()) if score else float(self.found)

    def init(self, image: Image, box: Iterable[float]) -> None:
        """Start on the box; OpenCV takes whole pixels only."""
        x, y, w, h = (round(v) for v in box)
        self._tracker.init(image, (x, y, w, h))
        self._box = (float(x), float(y), float(w), float(h))

    def update(self, image: Image) -> Box:
        """Return the box in the next frame."""
        self.found, (x, y, w, h) = self._tracker.update(image)
        if self.found:
            self._box = (float(x), float(y), float(w), float(h))
        return self._box


class DlibPeer:
    """dlib's correlation tracker (of the DSST family), with its default parameters, on RGB."""

    def __init__(self) -> None:
        self._dlib: Any = importlib.import_module("dlib")
        self._tracker = self._dlib.correlation_tracker()
        self.confidence: float | None = None
        """The peak-to-sidelobe ratio of the last frame: not a probability."""

    def init(self, image: Image, box: Iterable[float]) -> None:
        """Start on the box; dlib's rectangles include their last pixel."""
        x, y, w, h = box
        rectangle = self._dlib.drectangle(x, y, x + w - 1, y + h - 1)
        self._tracker.start_track(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), rectangle)

    def update(self, image: Image) -> Box:
        """Return the box in the next frame."""
        self.confidence = float(self._tracker.update(cv2.cvtColor(image, cv2.COLOR_BGR2RGB)))
        place = self._tracker.get_position()
        return place.left(), place.top(), place.right() - place.left() + 1, place.bottom() - place.top() + 1


def _kcf() -> Any:
    parameters = _cv.TrackerKCF_Params()
    parameters.detect_thresh = 0.0  # at the default 0.5 it gives up within a few frames of most sequences
    return _cv.TrackerKCF_create(parameters)


def _nano_files() -> list[Path]:
    """Return the backbone and the head of NanoTrack, whether they are there or not."""
    folder = Path(os.environ.get(NANOTRACK) or ".")
    return [folder / name for name in NANOTRACK_FILES]


def _nano() -> Any:
    parameters = _cv.TrackerNano_Params()
    parameters.backbone, parameters.neckhead = map(str, _nano_files())
    return _cv.TrackerNano_create(parameters)


_OPENCV: dict[str, tuple[str, Callable[[], Any]]] = {
    "opencv-csrt": ("TrackerCSRT_create", lambda: _cv.TrackerCSRT_create()),
    "opencv-kcf": ("TrackerKCF_create", _kcf),
    "opencv-mosse": ("legacy", lambda: _cv.legacy.TrackerMOSSE_create()),
    "opencv-mil": ("TrackerMIL_create", lambda: _cv.TrackerMIL_create()),
    "opencv-nano": ("TrackerNano_create", _nano),
}

PEERS = (*_OPENCV, "dlib")


@dataclass(frozen=True)
class Peer:
    """A tracker of :data:`PEERS` by name; an :class:`~mfcmt_core.otb.trackers.Entry`."""

    name: str
    peer: str

    @property
    def identity(self) -> dict[str, Any]:
        """Return what results depend on; the library's version stands for its code."""
        library = importlib.import_module("dlib") if self.peer == "dlib" else _cv
        return {"code": f"{self.peer} {library.__version__}", "config": {}}

    @property
    def lacks(self) -> str | None:
        """Return what must be installed before :meth:`make` works; None if nothing is missing."""
        if self.peer == "dlib":
            return None if importlib.util.find_spec("dlib") else "dlib"
        if not hasattr(_cv, _OPENCV[self.peer][0]):
            return "opencv-contrib-python-headless"
        if self.peer == "opencv-nano" and not all(path.is_file() for path in _nano_files()):
            return f"NanoTrack's two files ({NANOTRACK} names the folder)"
        return None

    def make(self) -> OpenCVPeer | DlibPeer:
        """Return a tracker that has not started."""
        return DlibPeer() if self.peer == "dlib" else OpenCVPeer(_OPENCV[self.peer][1])
