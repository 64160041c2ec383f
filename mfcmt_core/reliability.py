"""Section III-C: is this frame reliable enough to learn from, and is the target still there?"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from .config import MFCMTConfig
from .result import Flags, Scores, Status

HISTORY = 10
"""Frames that a peak is compared with (section III-C)."""
MAX_SCORE = 1e9
"""After frames without content a ratio of peaks knows no bounds; infinity has no place on a wire."""


@dataclass(frozen=True, slots=True)
class Peaks:
    """Highest values of one frame: of the fused map, the mean of the template responses', the statistical one's."""

    fused: float
    template: float
    statistical: float

    @property
    def strength(self) -> tuple[float, float]:
        """What tells one place from another: the template peak, or where there is none the statistical one."""
        return self.template, self.statistical


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the three tests say about one frame."""

    flags: Flags
    scores: Scores
    reliable: bool
    status: Status


class Reliability:
    """Compares each frame's peaks with their means over the last ten frames, reliable or not.

    ``usual`` holds slow means of the template and the statistical peak over frames that were learned from.
    The ten-frame means sink with a vanishing target and would call it reliable again; the slow ones remember.
    ``doubtful`` says of the last frame that its template peak was too low wherever the tracker looked.
    """

    def __init__(self, config: MFCMTConfig) -> None:
        self.config = config
        self.history: deque[tuple[float, float, float]] = deque(maxlen=HISTORY)
        self.usual = (0.0, 0.0)
        self.learned = 0
        self.unreliable_run = 0
        self.lost = False
        self.doubtful = False

    def judge(self, peaks: Peaks) -> Verdict:
        """The verdict on a frame, whose peaks join the history."""
        c = self.config
        values = (peaks.fused, peaks.template, peaks.statistical)
        # a flat history (mean 0) and an empty one test nothing
        means = [sum(column) / len(self.history) for column in zip(*self.history, strict=True)] or values
        scores = Scores(*(min(v / m, MAX_SCORE) if m > 0 else 1.0 for v, m in zip(values, means, strict=True)))
        self.history.append(values)
        faint_template, faint_statistical = self._faint(peaks, c.usual_threshold)
        flags = Flags(
            scores.fused > c.fused_threshold,
            scores.template > c.template_threshold and not faint_template,
            scores.statistical > c.statistical_threshold and not faint_statistical,
        )
        reliable = flags.fused and flags.template and flags.statistical
        self.unreliable_run = 0 if reliable else self.unreliable_run + 1
        if self.lost:
            self.lost = not reliable or any(self._faint(peaks, c.found_threshold))
        elif c.lost_after and self.unreliable_run >= c.lost_after:
            self.lost = True
        status: Status = "lost" if self.lost else "tracking" if reliable else "uncertain"
        return Verdict(flags, scores, reliable and not self.lost, status)

    def doubts(self, peaks: Peaks) -> bool:
        """Whether the template peak is too low for the target to be surely there."""
        return self._faint(peaks, self.config.doubt_threshold)[0]

    def learned_from(self, peaks: Peaks) -> None:
        """The models learned from a frame with these peaks."""
        self.learned += 1
        part = 1 / min(self.learned, self.config.usual_frames)
        template, statistical = self.usual
        self.usual = (
            template + (peaks.template - template) * part,
            statistical + (peaks.statistical - statistical) * part,
        )

    def _faint(self, peaks: Peaks, threshold: float) -> tuple[bool, bool]:
        """Whether the template and the statistical peak are below that part of what is usual."""
        if self.learned < HISTORY:
            return False, False
        template, statistical = self.usual
        return peaks.template < threshold * template, peaks.statistical < threshold * statistical
