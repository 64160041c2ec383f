"""Follow several targets through one source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..config import MFCMTConfig
from ..errors import BadBox
from ..exports import Row, Target
from ..result import Box, TrackResult
from ..tracker import MFCMT
from ..video import Frame, VideoError


@dataclass(frozen=True)
class Start:
    """A target and its box in the frame in which it begins."""

    target: Target
    box: Box
    frame: int = 0


class Follower:
    """Follows targets, each from the frame of its start on.

    ``rescale`` says what happens if frames change their size: targets start anew with scaled boxes, or VideoError.
    """

    def __init__(self, starts: Sequence[Start], config: MFCMTConfig, *, rescale: bool = False) -> None:
        self._waiting = sorted(starts, key=lambda start: start.frame)
        self._config, self._rescale = config, rescale
        self._size: tuple[int, int] | None = None
        self._followed: dict[Target, MFCMT] = {}
        self._last: dict[Target, TrackResult] = {}
        self.refused: list[str] = []

    @property
    def waiting(self) -> list[Start]:
        """The targets whose frame has not come."""
        return self._waiting

    def update(self, frame: Frame) -> list[Row]:
        """Return a row of each target that has begun.

        Raises VideoError if the frame has another size than the first one, and BadBox for a target of frame 0. Why a
        later one cannot be started is kept in ``refused``.
        """
        size = (frame.image.shape[1], frame.image.shape[0])
        if self._size is not None and self._size != size:
            self._resize(frame, self._size, size)
        else:
            for target, tracker in self._followed.items():
                self._last[target] = tracker.update(frame.image)
        self._size = size
        while self._waiting and self._waiting[0].frame <= frame.index:
            self._begin(self._waiting.pop(0), frame)
        return [Row(frame.index, frame.time_s, target, result) for target, result in self._last.items()]

    def _begin(self, start: Start, frame: Frame) -> None:
        tracker = MFCMT(self._config)
        try:
            self._last[start.target] = tracker.init(frame.image, start.box)
        except BadBox as bad:
            if not start.frame:
                raise BadBox(f"box {','.join(f'{v:g}' for v in start.box)}: {bad.reason}") from bad
            self.refused.append(f"{start.target.name}, frame {start.frame}: {bad.reason}")
            return
        self._followed[start.target] = tracker

    def _resize(self, frame: Frame, before: tuple[int, int], size: tuple[int, int]) -> None:
        if not self._rescale:
            raise VideoError(
                "frame {} is {}x{}, the first one is {}x{}: --on-resize rescale scales the boxes with it".format(
                    frame.index, *size, *before
                )
            )
        across, down = size[0] / before[0], size[1] / before[1]
        for target in self._followed:
            x, y, w, h = self._last[target].box
            w, h = w * across, h * down
            # A target that has left the frame waits for its return at the border.
            x = min(max(x * across, 0.0), max(size[0] - w, 0.0))
            y = min(max(y * down, 0.0), max(size[1] - h, 0.0))
            tracker = MFCMT(self._config)
            try:
                self._last[target] = tracker.init(frame.image, (x, y, w, h))
            except BadBox as bad:
                raise VideoError(f"{target.name} cannot be carried over to frame {frame.index}: {bad.reason}") from bad
            self._followed[target] = tracker
