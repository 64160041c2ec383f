"""Section III-C: is this frame reliable enough to learn from, and is the target still there?"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from .config import MFCMTConfig
from .result import Flags, Scores, Status

HISTORY = 10
"""Number of past frames that a peak is compared with (section III-C)."""
MAX_SCORE = 1e9
"""Upper bound of a score. After frames without content the ratio of peaks is unbounded, and JSON has no infinity."""


@dataclass(frozen=True, slots=True)
class Peaks:
    """Highest values of one frame's maps: the fused map, the template responses (their mean), the statistical one."""

    fused: float
    template: float
    statistical: float

    @property
    def strength(self) -> tuple[float, float]:
        """The key by which places are compared: the template peak, or without a template model the statistical one."""
        return self.template, self.statistical


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the three tests and the confidence say about one frame.

    ``learnable`` is True if the models shall learn from the frame. ``confidence`` is that in the reported box.
    """

    flags: Flags
    scores: Scores
    confidence: float
    reliable: bool
    learnable: bool
    status: Status


class Reliability:
    """Compares each frame's peaks with their means over the last ten frames, reliable or not.

    ``long_term_means`` are the means of the template and the statistical peak over the frames that were learned. The
    ten-frame means sink with a vanishing target and would call it reliable again; the long-term means do not.
    ``learned`` counts the learned frames, ``unreliable_run`` the frames in a row that failed a test, and ``low_run``
    those in a row that count towards a lost target: the same, or with a status by confidence those of low confidence.
    ``tracking`` is True if that was the last frame's status.
    ``template_low`` says that the last frame's template peak was low at the target's place.
    """

    def __init__(self, config: MFCMTConfig) -> None:
        self.config = config
        self.history: deque[tuple[float, float, float]] = deque(maxlen=HISTORY)
        self.long_term_means = (0.0, 0.0)
        self.learned = 0
        self.unreliable_run = 0
        self.low_run = 0
        self.lost = False
        self.template_low = False
        self.tracking = True

    def start(self, confidence: float) -> Status:
        """Return the status of the first frame."""
        self.tracking = confidence >= self.config.tracking_threshold
        return "tracking" if self.tracking else "uncertain"

    @property
    def searching(self) -> bool:
        """Whether the next frame is searched as a whole: the target is lost, or the confidence has been low."""
        after = self.config.search_after
        return self.lost or 0 < after <= self.low_run

    def judge(self, peaks: Peaks, confidence: float, is_jump: bool = False) -> Verdict:
        """Return the verdict on a frame and add its peaks to the history.

        ``confidence`` is that in its candidate, and ``is_jump`` says that the search of the whole frame found it.
        """
        c = self.config
        values = (peaks.fused, peaks.template, peaks.statistical)
        # a flat history (mean 0) and an empty one test nothing
        means = [sum(column) / len(self.history) for column in zip(*self.history, strict=True)] or values
        scores = Scores(*(min(v / m, MAX_SCORE) if m > 0 else 1.0 for v, m in zip(values, means, strict=True)))
        self.history.append(values)
        low_template, low_statistical = self._is_low(peaks, c.usual_threshold)
        flags = Flags(
            scores.fused > c.fused_threshold,
            scores.template > c.template_threshold and not low_template,
            scores.statistical > c.statistical_threshold and not low_statistical,
        )
        passed = flags.fused and flags.template and flags.statistical
        if c.tracking_threshold:
            self.tracking = confidence >= c.tracking_threshold + (0 if self.tracking else c.hysteresis)
            is_low = confidence < c.lost_threshold
        else:
            self.tracking, is_low = passed, not passed
        self.unreliable_run = 0 if passed else self.unreliable_run + 1
        self.low_run = self.low_run + 1 if is_low else 0
        if is_jump and c.tracking_threshold:
            self.lost, self.low_run = False, 0
        elif self.lost:
            self.lost = not self.tracking or any(self._is_low(peaks, c.found_threshold))
        elif c.lost_after and self.low_run >= c.lost_after:
            self.lost = True
        if self.lost:
            self.tracking = False
            if c.tracking_threshold:  # the candidate was refused, so the reported box is an older one
                confidence = min(confidence, c.lost_threshold)
        status: Status = "lost" if self.lost else "tracking" if self.tracking else "uncertain"
        learnable = passed and not self.lost and confidence >= c.learn_threshold
        return Verdict(flags, scores, confidence, passed and self.tracking, learnable, status)

    def is_peak_low(self, peaks: Peaks) -> bool:
        """Return True if a peak is below ``usual_threshold`` of its long-term mean."""
        return any(self._is_low(peaks, self.config.usual_threshold))

    def is_template_low(self, peaks: Peaks) -> bool:
        """Return True if the template peak is below ``doubt_threshold`` of its long-term mean."""
        return self._is_low(peaks, self.config.doubt_threshold)[0]

    def record_learned(self, peaks: Peaks) -> None:
        """Add the peaks of a frame that the models learned to the long-term means."""
        self.learned += 1
        weight = 1 / min(self.learned, self.config.usual_frames)
        template, statistical = self.long_term_means
        self.long_term_means = (
            template + (peaks.template - template) * weight,
            statistical + (peaks.statistical - statistical) * weight,
        )

    def _is_low(self, peaks: Peaks, threshold: float) -> tuple[bool, bool]:
        """Return whether the template and the statistical peak are below ``threshold`` of their long-term means."""
        if self.learned < HISTORY:
            return False, False
        template, statistical = self.long_term_means
        return peaks.template < threshold * template, peaks.statistical < threshold * statistical
