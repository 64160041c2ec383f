"""Decoded pixels, where they are in the frame, and the start of a tracker on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from mfcmt_core import MFCMT, BadBox, RegionTooSmall, TrackResult
from mfcmt_core.images.decode import Image

from .rows import Rect


class Refused(Exception):
    """The operation is refused and nothing has changed: a code of the catalogue and what may be told."""

    def __init__(self, code: str, detail: str, **members: Any) -> None:
        super().__init__(detail)
        self.code, self.detail, self.members = code, detail, members


@dataclass(frozen=True, slots=True)
class FrameView:
    """``image`` is the part of a frame of ``frame_size`` (w, h) whose top-left pixel is ``offset`` (x, y)."""

    image: Image
    offset: tuple[int, int]
    frame_size: tuple[int, int]

    @property
    def rect(self) -> Rect:
        """The part that is shown."""
        return (*self.offset, self.image.shape[1], self.image.shape[0])

    def start(self, tracker: MFCMT, box: Iterable[float]) -> TrackResult:
        """``tracker`` started or corrected here. Raises Refused."""
        x, y, w, h = box
        width, height = self.frame_size
        try:
            return tracker.init(self.image, (x, y, w, h), offset=self.offset, frame_size=self.frame_size)
        except BadBox as bad:
            raise Refused("bad-box", bad.reason) from bad
        except RegionTooSmall as cut:
            whole = [0, 0, width, height]
            raise Refused("full-frame-needed", "send the whole frame", region=whole) from cut

    def update(self, tracker: MFCMT, maps: bool) -> TrackResult:
        """The target in this frame."""
        return tracker.update(self.image, offset=self.offset, frame_size=self.frame_size, maps=maps)
