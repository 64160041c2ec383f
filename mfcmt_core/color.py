"""The statistical model: colour histograms of foreground and background (equations 4–7)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .geometry import CELL, Image, SearchWindow
from .kernels.color import bin_gray, bin_pixels, box_means, learn_colors, look_up, tabulate
from .workspace import scratch

Bins = npt.NDArray[np.uint16]

BINS = 32
"""Bins a channel (section IV-A)."""


class ColorModel:
    """Says of each pixel how likely its colour belongs to the target, and where a box of such pixels lies.

    The foreground is the middle 85 % of the target's sides, the background the window outside the whole
    target; the ring between belongs to neither. Each histogram has sum 1, which makes equation 6 the
    regression of equation 5 with its two terms normalised by area. A grey sequence has one axis of bins.
    """

    def __init__(self, config: MFCMTConfig, window: SearchWindow, grey: bool) -> None:
        self.grey = grey
        self.rate = np.float32(config.histogram_learning_rate)
        self.unseen = np.float32(config.unseen_likelihood)
        size = BINS if grey else BINS**3
        self.foreground = np.zeros(size, np.float32)
        self.background = np.zeros(size, np.float32)
        self.lookup = np.zeros(size, np.float32)
        side = window.patch_size
        per_cell = side / window.cells  # 150 px hold 37 cells of 4.05
        w, h = window.target[0] * per_cell, window.target[1] * per_cell
        self.inner = _centered(side, w * config.foreground_fraction, h * config.foreground_fraction)
        self.outer = _centered(side, w, h)
        self.box = (self.outer[3] - self.outer[1], self.outer[2] - self.outer[0])  # (w, h)
        (rx, ry), (bw, bh) = window.reach, self.box
        steps_x, steps_y = np.arange(-rx, rx + 1) * CELL, np.arange(-ry, ry + 1) * CELL
        self.columns = np.clip((side - bw) // 2 + steps_x, 0, side - bw)
        self.rows = np.clip((side - bh) // 2 + steps_y, 0, side - bh)

    def respond(self, bins: Bins, out: npt.NDArray[np.float32]) -> float:
        """Mean likelihood of the target's box at each displacement into ``out``; its highest value, in [0, 1]."""
        height, width = bins.shape
        integral = scratch("integral", (height + 1, width + 1))
        look_up(bins, self.lookup, integral)
        box_means(integral, self.rows, self.columns, self.box[1], self.box[0], out)
        return float(out.max())

    def learn(self, bins: Bins, first: bool = False) -> None:
        """Move both histograms towards those of a patch centred on the target (equation 11)."""
        rate = np.float32(1) if first else self.rate
        counts = scratch("color_counts", (2, len(self.foreground)), np.int32)  # nobody else's: always zero
        learn_colors(bins, self.inner, self.outer, rate, counts, self.foreground, self.background)
        self.refresh()

    def refresh(self) -> None:
        """Compute the look-up table from the histograms."""
        tabulate(self.foreground, self.background, self.unseen, self.lookup)

    def bins(self, patch: Image) -> Bins:
        """The histogram bin of each pixel of ``patch`` (H, W[, 3]), (H, W) uint16."""
        bins = np.empty(patch.shape[:2], np.uint16)
        (bin_gray if self.grey else bin_pixels)(patch, bins)
        return bins


def _centered(side: int, width: float, height: float) -> tuple[int, int, int, int]:
    """``(top, left, bottom, right)`` of a centred box of at least one pixel in a square patch."""
    w, h = min(max(round(width), 1), side), min(max(round(height), 1), side)
    top, left = (side - h) // 2, (side - w) // 2
    return top, left, top + h, left + w
