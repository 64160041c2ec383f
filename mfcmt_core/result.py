"""The result of one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Box = tuple[float, float, float, float]
"""``(x, y, w, h)`` in pixels of the frame: the 0-based top-left corner and the size, which is positive."""

Status = Literal["tracking", "uncertain", "lost"]


@dataclass(frozen=True, slots=True)
class Flags:
    """The three tests of section III-C. Each is True if its peak is high enough against the last ten frames."""

    fused: bool
    template: bool
    statistical: bool


@dataclass(frozen=True, slots=True)
class Scores:
    """Each peak divided by its mean over the last ten frames. 1 is normal; the thresholds are γ_q, γ_t and γ_s."""

    fused: float
    template: float
    statistical: float


@dataclass(frozen=True, slots=True)
class TrackResult:
    """Where the target is in one frame and how far to trust it.

    Attributes
    ----------
    box : (float, float, float, float)
        ``(x, y, w, h)`` in pixels of the frame. While the target is lost, this is its last reliable box.
    status : {"tracking", "uncertain", "lost"}
        With the default preset it follows from the confidence: ``"tracking"`` from ``tracking_threshold`` on,
        ``"lost"`` after many frames below ``lost_threshold``, otherwise ``"uncertain"``. With the paper's it is
        ``"tracking"`` if the frame passed all three tests.
    reliable : bool or None
        True if the frame passed all three tests and the status is ``"tracking"``. None on the frame that started the
        target, as the next three.
    flags : Flags or None
        The three tests one by one.
    scores : Scores or None
        The ratios that are tested.
    psr : float or None
        Peak-to-sidelobe ratio of the fused map, without the 11×11 cells around the peak.
    updated : bool
        True if the models learned from this frame.
    scale : float
        The size of the box relative to the box that was given.
    confidence : float
        Probability, 0 to 1, that the box overlaps the target by more than half. This is the number to act on.
    maps : dict of ndarray or None
        The response maps by name, if they were asked for: ``fused``, one per model, and one per cue. Each is float32
        of shape (rows, columns), with zero displacement in the middle, and has sum 1 unless ``probability`` is "raw".
    """

    box: Box
    status: Status
    reliable: bool | None
    flags: Flags | None
    scores: Scores | None
    psr: float | None
    updated: bool
    scale: float
    confidence: float = 1.0
    maps: dict[str, npt.NDArray[np.float32]] | None = None
