"""What the tracker says about one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Box = tuple[float, float, float, float]
"""``(x, y, w, h)``: pixels of the frame, 0-based, top-left corner, ``w, h > 0``."""

Status = Literal["tracking", "uncertain", "lost"]


@dataclass(frozen=True, slots=True)
class Flags:
    """The three tests of section III-C: is the peak of this frame high enough against the last ten?"""

    fused: bool
    template: bool
    statistical: bool


@dataclass(frozen=True, slots=True)
class Scores:
    """Each peak divided by its mean over the last ten frames; 1 is usual, the thresholds are γ."""

    fused: float
    template: float
    statistical: float


@dataclass(frozen=True, slots=True)
class TrackResult:
    """Where the target is in one frame and how far to trust it.

    ``box`` is the last known one while ``status`` is ``"lost"``. ``flags``, ``scores``, ``psr`` and
    ``reliable`` are ``None`` on the frame that started the target. ``psr`` is the peak-to-sidelobe ratio of
    the fused map, 11×11 around the peak left out. ``updated`` says whether the models learned from this
    frame, ``scale`` is the size relative to the box given. ``maps`` holds the response maps by name
    (``fused``, one a model and one a cue; ``float32``, each of sum 1) where they were asked for.
    """

    box: Box
    status: Status
    reliable: bool | None
    flags: Flags | None
    scores: Scores | None
    psr: float | None
    updated: bool
    scale: float
    maps: dict[str, npt.NDArray[np.float32]] | None = None
