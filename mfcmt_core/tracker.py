"""The tracker (stub with the final interface, until the real one lands)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .errors import BadBox, NotInitialised
from .result import Box, TrackResult

Image = npt.NDArray[np.uint8]


class MFCMT:
    """Single-target tracker."""

    def __init__(self, config: MFCMTConfig | None = None) -> None:
        self.config = config or MFCMTConfig.default()
        self._box: Box | None = None

    def init(
        self,
        image: Image,
        box: Iterable[float],
        *,
        offset: tuple[int, int] = (0, 0),
        frame_size: tuple[int, int] | None = None,
    ) -> TrackResult:
        """Start on ``box`` (also to correct a running tracker).

        ``image`` may be a cut of the frame: then ``offset`` is the frame's (x, y) of its top-left pixel and
        ``frame_size`` the whole frame's (w, h); the box is always in coordinates of the whole frame.
        Raises BadBox, BadImage, RegionTooSmall.
        """
        x, y, w, h = (float(v) for v in box)
        if not w * h > 0:
            raise BadBox(f"no area: {(x, y, w, h)}")
        self._box = (x, y, w, h)
        self._frame_size = frame_size or (image.shape[1], image.shape[0])
        return TrackResult(self._box, "tracking", None, None, None, None, True, 1.0)

    def update(
        self,
        image: Image,
        *,
        offset: tuple[int, int] = (0, 0),
        frame_size: tuple[int, int] | None = None,
        maps: bool = False,
    ) -> TrackResult:
        """Find the target in the next frame. Raises NotInitialised, BadImage, RegionTooSmall."""
        if self._box is None:
            raise NotInitialised("update before init")
        return TrackResult(self._box, "tracking", None, None, None, None, True, 1.0)

    def track(self, frames: Iterable[Image], box: Iterable[float]) -> Iterator[TrackResult]:
        """Start on the first of ``frames`` and yield one result a frame."""
        for i, frame in enumerate(frames):
            yield self.init(frame, box) if i == 0 else self.update(frame)

    def needed_region(self) -> tuple[int, int, int, int]:
        """The part of the next frame that ``update`` may look at, (x, y, w, h) in whole pixels."""
        return (0, 0, *self._frame_size)

    def region(self, lag: int = 1) -> tuple[int, int, int, int]:
        """``needed_region`` with room for ``lag`` frames in flight."""
        return (0, 0, *self._frame_size)

    def to_bytes(self) -> bytes:
        """The whole state; see :meth:`from_bytes`."""
        return b""

    @classmethod
    def from_bytes(cls, data: bytes) -> MFCMT:
        """A tracker whose every later result is bit-equal. Raises BadSnapshot."""
        return cls()
