"""How likely it is that the box is right: a logistic regression on signals that do not follow a drift.

The three tests of section III-C compare a frame with the last ten; a tracker that has drifted is content with what it
drifted to. The signals here are absolute: how sharp the fused map is, how well the colors fit, and how much the box
looks like the first frame's. Nothing of them is learned on the way, so nothing of them drifts. ``mfcmt eval
--fit-confidence`` fits the constants; docs/evaluation.md says what they are worth on video that they were not fitted
to.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log

import numpy as np
import numpy.typing as npt

from .kernels.appearance import LENGTH, compare_box, describe_box, deviation_of_cells
from .workspace import scratch

SIGNALS = (
    "log_psr",
    "second_peak",
    "statistical_peak",
    "first_gradients",
    "first_colors",
    "surroundings",
    "log_contrast",
    "inside",
)
"""What one frame says. ``surroundings`` is how like the box's colors are to those beside it: a background continues."""
SLOW = ("log_psr", "second_peak", "first_gradients")
"""The signals whose slow means are taken: one blurred frame is no loss, ten are."""
COLUMNS = (*SIGNALS, *(f"mean_{name}" for name in SLOW))
"""The names of the signals and of the slow means."""


@dataclass(frozen=True)
class Model:
    """A logistic regression: a ``bias``, and ``weights`` of some of :data:`COLUMNS` by name."""

    bias: float
    weights: dict[str, float]


DEFAULT = Model(
    bias=-11.2752,
    weights={
        "second_peak": -1.5541,
        "statistical_peak": 1.3079,
        "first_gradients": 2.0992,
        "first_colors": 2.0617,
        "surroundings": -2.8505,
        "log_contrast": 1.0360,
        "inside": 6.4597,
        "mean_log_psr": 0.6196,
        "mean_second_peak": -2.6631,
        "mean_first_gradients": 3.3960,
    },
)
"""For the maps of ``default()``."""

SLOW_RATE = 0.1
"""The rate of the slow means per frame; they are plain means over the first ten."""
FLAT_CELLS = 1.0
"""Standard deviation in gray levels of the search window's cells, below which there is nothing in it to follow."""
FLAT_BOX = 2.0
"""The same of the box's pixels. The window is tested only around a box that is flatter."""
NOTHING = 0.1
"""Highest confidence of a box in a flat window, and of a target that was started there."""
MIN_PSR = 0.3
"""Lower peak-to-sidelobe ratios count as this one."""

_SLOW = tuple(SIGNALS.index(name) for name in SLOW)
WEIGHED = tuple(COLUMNS.index(name) for name in DEFAULT.weights)
"""Indices of the columns that every model weighs."""


@dataclass(frozen=True, slots=True)
class MapEvidence:
    """What the response maps of one search say: see :data:`SIGNALS`."""

    psr: float
    second_peak: float
    statistical_peak: float


@dataclass(frozen=True, slots=True)
class BoxPixels:
    """A box in a patch: ``gray`` (H, W) uint8, ``bins`` (H, W) uint16 of 1 or 3 ``channels``, where the box lies.

    ``left``, ``top``, ``width`` and ``height`` are pixels of the patch, ``inside`` the part of the box in the frame.
    """

    gray: npt.NDArray[np.uint8]
    bins: npt.NDArray[np.uint16]
    channels: int
    left: float
    top: float
    width: float
    height: float
    inside: float


class Confidence:
    """The confidence in one target's boxes, from frame to frame.

    ``first`` is the look of the given box, (LENGTH,) float32 as :mod:`.kernels.appearance` has it. ``slow`` holds the
    slow means and ``judged`` the number of frames in them. ``blank`` is True if there was nothing to follow in the
    first frame, and ``known`` if there is a first look. ``signals`` are those of the last frame.
    """

    def __init__(self, model: Model = DEFAULT) -> None:
        self._bias = model.bias
        self._weights = tuple(model.weights[COLUMNS[index]] for index in WEIGHED)
        self.first: npt.NDArray[np.float32] = np.zeros(LENGTH, np.float32)
        self.slow = [0.0] * len(SLOW)
        self.judged = 0
        self.known = False
        self.blank = False
        self.signals: tuple[float, ...] = ()

    def start(self, box: BoxPixels) -> float:
        """Take the first frame's box as the look to compare with. Return its confidence."""
        deviation = describe_box(box.gray, box.bins, box.channels, box.left, box.top, box.width, box.height, self.first)
        self.known = True
        self.blank = _is_flat(box, deviation)
        return NOTHING if self.blank else 1.0

    def judge(self, maps: MapEvidence, box: BoxPixels, is_new: bool) -> tuple[float, bool]:
        """Return the confidence in a box of the next frame, and whether its window is flat.

        ``is_new`` is True if the box does not go on from the last one: then the slow means begin with it.
        """
        if not self.known:  # restored from a snapshot without a look: this one takes the place of the first
            self.start(box)
        signals, is_flat = self._compare(maps, box)
        self.judged = 1 if is_new else self.judged + 1
        rate = max(SLOW_RATE, 1 / self.judged)
        self.slow = [mean + rate * (signals[index] - mean) for mean, index in zip(self.slow, _SLOW, strict=True)]
        self.signals = (*signals, *self.slow)
        return self._weigh(self.signals, is_flat), is_flat

    def estimate(self, maps: MapEvidence, box: BoxPixels) -> float:
        """Return what :meth:`judge` would give for a box that does not go on from the last one, and change nothing."""
        signals, is_flat = self._compare(maps, box)
        return self._weigh((*signals, *(signals[index] for index in _SLOW)), is_flat)

    def _compare(self, maps: MapEvidence, box: BoxPixels) -> tuple[tuple[float, ...], bool]:
        """Return the signals of one frame, and whether the window is flat."""
        deviation, gradients, colors, surroundings = compare_box(
            box.gray, box.bins, box.channels, box.left, box.top, box.width, box.height, self.first,
            scratch("look", (LENGTH,)),
        )  # fmt: skip
        signals = (
            log(max(maps.psr, MIN_PSR)),
            maps.second_peak,
            maps.statistical_peak,
            gradients,
            colors,
            surroundings,
            log(deviation + 1),
            box.inside,
        )
        return signals, _is_flat(box, deviation)

    def _weigh(self, columns: tuple[float, ...], is_flat: bool) -> float:
        """Return the probability that the logistic regression gives for signals and slow means."""
        score = self._bias + sum(weight * columns[index] for weight, index in zip(self._weights, WEIGHED, strict=True))
        confidence = 1 / (1 + exp(-min(max(score, -30.0), 30.0)))
        return min(confidence, NOTHING) if is_flat or self.blank else confidence


def _is_flat(box: BoxPixels, deviation: float) -> bool:
    """Return True if the window around a box has nothing to follow; ``deviation`` is that of the box's pixels."""
    return deviation < FLAT_BOX and deviation_of_cells(box.gray) < FLAT_CELLS
