"""The statistical model: colour histograms of foreground and background (equations 4–7)."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .geometry import CELL, Image, SearchWindow
from .kernels.color import bin_gray, learn_colors, likelihood_map, tabulate
from .workspace import scratch

Bins = npt.NDArray[np.uint16]
Rectangle = tuple[int, int, int, int]
"""``(top, left, bottom, right)`` in pixels of the patch."""

BINS = 32
"""Bins a channel (section IV-A)."""
MAX_DECAY_SCALE = np.float32(1e9)
"""Of the histograms; beyond it they are scaled back to 1."""
BAND_FRACTION = 0.1
"""Width of the band around a box, of the box's sides."""
MIN_MASS = 1e-12
"""Part of both regions from which on a colour counts as seen then."""


class ColorModel:
    """Says of each pixel how likely its colour belongs to the target, and where a box of such pixels lies.

    Equation 7's mean over a box is as high wherever the box lies inside a larger region of such colours. So a part of
    the mean over a band around the box is taken from it: a box that holds the target has none of it around.

    The foreground is the middle 85 % of the target's sides, the background the window outside the whole
    target; the ring between belongs to neither. Each histogram has sum 1, which makes equation 6 the
    regression of equation 5 with its two terms normalised by area. A grey sequence has one axis of bins.

    ``histograms`` (bins, 2) float32, foreground and background, are kept times ``decay_scale``: where the rest would
    fade by 1 - η, what is new counts the more instead. Equation 6 does not see a common factor, and of thousands
    of bins only those have to be touched that a patch shows.
    """

    def __init__(self, config: MFCMTConfig, search_window: SearchWindow, is_gray: bool) -> None:
        self.is_gray = is_gray
        self.rate = np.float32(config.histogram_learning_rate)
        self.unseen = np.float32(config.unseen_likelihood)
        size = BINS if is_gray else BINS**3
        self.histograms = np.zeros((size, 2), np.float32)
        self.decay_scale = np.ones(1, np.float32)
        self.lookup = np.zeros(size, np.float32)
        side = search_window.patch_size
        per_cell = side / search_window.cells  # 150 px hold 37 cells of 4.05
        w, h = search_window.target[0] * per_cell, search_window.target[1] * per_cell
        self.inner = _centered(side, w * config.foreground_fraction, h * config.foreground_fraction)
        self.outer = _centered(side, w, h)
        self.box = (self.outer[3] - self.outer[1], self.outer[2] - self.outer[0])  # (w, h)
        self.band = tuple(max(1, round(BAND_FRACTION * length)) for length in self.box)
        self.band_weight = np.float32(config.surroundings_weight)
        (rx, ry), (bw, bh) = search_window.reach, self.box
        steps_x, steps_y = np.arange(-rx, rx + 1) * CELL, np.arange(-ry, ry + 1) * CELL
        self.columns = np.clip((side - bw) // 2 + steps_x, 0, side - bw)
        self.rows = np.clip((side - bh) // 2 + steps_y, 0, side - bh)

    def respond(self, bins: Bins, out: npt.NDArray[np.float32]) -> None:
        """How much likelier the colours of the target's box are than those around it, at each displacement.

        Into ``out`` (2·ry + 1, 2·rx + 1), from -weight of the surroundings to 1.
        """
        height, width = bins.shape
        integral = scratch("integral", (height + 1, width + 1))
        likelihood_map(
            bins, self.lookup, integral, self.rows, self.columns, self.box[1], self.box[0],
            self.band[1], self.band[0], self.band_weight, out,
        )  # fmt: skip

    def learn(self, bins: Bins, offset: tuple[float, float] = (0, 0), first: bool = False) -> None:
        """Move both histograms towards those of a patch of the target (equation 11), ``offset`` (x, y) cells off it."""
        rate = np.float32(1) if first else self.rate
        self._decay(np.float32(1) - rate)
        dx, dy = round(offset[0] * CELL), round(offset[1] * CELL)
        shown = scratch("colors_shown", (bins.size,), np.uint16)
        counts = scratch("color_counts", self.lookup.shape, np.int64)  # nobody else's: always zero
        learn_colors(
            bins, self.inner, self.outer, dx, dy, rate, self.decay_scale[0], self.unseen, shown, counts,
            self.histograms, self.lookup,
        )  # fmt: skip

    def _decay(self, keep: np.float32) -> None:
        """Multiply what is known by ``keep``."""
        if keep * MAX_DECAY_SCALE > self.decay_scale[0]:
            self.decay_scale /= keep
            return
        self.histograms *= keep / self.decay_scale
        self.histograms[self.histograms.sum(1) < MIN_MASS] = 0
        self.decay_scale[0] = 1
        self.refresh()

    def refresh(self) -> None:
        """Compute the look-up table from the histograms."""
        tabulate(self.histograms, self.unseen, self.lookup)

    def bins(self, patch: Image) -> Bins:
        """The histogram bin of each pixel of ``patch`` (H, W[, 3]), (H, W) uint16."""
        if not self.is_gray:  # five bits of each of red, green and blue, red lowest
            return cv2.cvtColor(patch, cv2.COLOR_RGB2BGR555).view(np.uint16)[..., 0]
        bins = np.empty(patch.shape, np.uint16)
        bin_gray(patch, bins)
        return bins


def _centered(side: int, width: float, height: float) -> Rectangle:
    """A centred box of at least one pixel in a square patch."""
    w, h = min(max(round(width), 1), side), min(max(round(height), 1), side)
    top, left = (side - h) // 2, (side - w) // 2
    return top, left, top + h, left + w
