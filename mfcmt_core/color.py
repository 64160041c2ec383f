"""The statistical model: color histograms of foreground and background (equations 4–7)."""

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
"""Number of bins per channel (section IV-A)."""
MAX_DECAY_SCALE = np.float32(1e9)
"""Largest decay scale; beyond it the histograms are rescaled."""
BAND_FRACTION = 0.1
"""Width of the band around a box, as a fraction of the box's sides."""
MIN_MASS = 1e-12
"""Smallest mass of a bin, in both histograms together, for its color to count as observed."""


class ColorModel:
    """Rates how likely each pixel's color belongs to the target, and finds the box with the likeliest pixels.

    Equation 7, the mean over a box, is equally high wherever the box lies inside a larger region of such colors.
    Therefore a fraction of the mean over a band around the box is subtracted: around the target there are other colors.

    The foreground is the middle 85 % of the target's sides. The background is the window outside the target. The ring
    between belongs to neither. Each histogram has sum 1, so that equation 6 is the regression of equation 5 with both
    terms normalized by area. A gray sequence has one axis of bins.

    ``histograms`` (bins, 2) float32 hold foreground and background, multiplied by ``decay_scale``. Instead of decaying
    every bin by 1 - η in every frame, new counts are weighted by ``decay_scale``, which grows by 1 / (1 - η) per frame
    (lazy decay). Equation 6 is a ratio and cancels the factor, and only the bins that a patch shows are touched.

    References
    ----------
    L. Bertinetto, J. Valmadre, S. Golodetz, O. Miksik and P. H. S. Torr, "Staple: Complementary Learners for Real-Time
    Tracking", CVPR 2016, arXiv:1512.01355. H. Possegger, T. Mauthner and H. Bischof, "In Defense of Color-based
    Model-free Tracking", CVPR 2015, doi:10.1109/CVPR.2015.7298823.
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
        """Write to ``out`` how much likelier the colors in the target's box are than those around it.

        ``bins`` (H, W) uint16 are those of :meth:`bins`. ``out`` (2·ry + 1, 2·rx + 1) float32 has a value per
        displacement, from -``surroundings_weight`` to 1.
        """
        height, width = bins.shape
        integral = scratch("integral", (height + 1, width + 1))
        likelihood_map(
            bins, self.lookup, integral, self.rows, self.columns, self.box[1], self.box[0],
            self.band[1], self.band[0], self.band_weight, out,
        )  # fmt: skip

    def learn(self, bins: Bins, offset: tuple[float, float] = (0, 0), first: bool = False) -> None:
        """Learn the histograms of a window whose middle is ``offset`` (x, y) cells from the target (equation 11)."""
        rate = np.float32(1) if first else self.rate
        self._decay(np.float32(1) - rate)
        dx, dy = round(offset[0] * CELL), round(offset[1] * CELL)
        shown = scratch("colors_shown", (bins.size,), np.uint16)
        counts = scratch("color_counts", self.lookup.shape, np.int64)  # used here alone, and always left zero
        learn_colors(
            bins, self.inner, self.outer, dx, dy, rate, self.decay_scale[0], self.unseen, shown, counts,
            self.histograms, self.lookup,
        )  # fmt: skip

    def _decay(self, keep: np.float32) -> None:
        """Multiply the learned histograms by ``keep``."""
        if keep * MAX_DECAY_SCALE > self.decay_scale[0]:
            self.decay_scale /= keep
            return
        self.histograms *= keep / self.decay_scale
        self.histograms[self.histograms.sum(1) < MIN_MASS] = 0
        self.decay_scale[0] = 1
        self.refresh()

    def refresh(self) -> None:
        """Compute the look-up table of likelihoods from the histograms."""
        tabulate(self.histograms, self.unseen, self.lookup)

    def bins(self, patch: Image) -> Bins:
        """Return the histogram bin of each pixel of ``patch`` (H, W) or (H, W, 3): an array (H, W) uint16."""
        if not self.is_gray:  # five bits of each of red, green and blue, red lowest
            return cv2.cvtColor(patch, cv2.COLOR_RGB2BGR555).view(np.uint16)[..., 0]
        bins = np.empty(patch.shape, np.uint16)
        bin_gray(patch, bins)
        return bins


def _centered(side: int, width: float, height: float) -> Rectangle:
    """Return a centered box of at least one pixel in a square patch."""
    w, h = min(max(round(width), 1), side), min(max(round(height), 1), side)
    top, left = (side - h) // 2, (side - w) // 2
    return top, left, top + h, left + w
