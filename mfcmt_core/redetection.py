"""Other places for a target: the second peak of the fused map, and places in the whole frame.

While the confidence is low, the whole frame is searched: for the place whose colors fit best, and for the place that
looks most like the target did when it was sure. Both look at a shrunken frame, so their cost does not depend on its
size. What they propose is probed with all models, and taken only if the confidence in it is high.

References
----------
C. Ma, X. Yang, C. Zhang and M.-H. Yang, "Long-term Correlation Tracking" (LCT), CVPR 2015,
doi:10.1109/CVPR.2015.7299177.
"""

from __future__ import annotations

from math import sqrt

import cv2
import numpy as np
import numpy.typing as npt

from .color import ColorModel
from .confidence import BoxPixels
from .geometry import Frame, Image, convert_channels
from .kernels.appearance import SIDE, take_pixels
from .kernels.color import box_means, integrate_likelihood
from .workspace import scratch

Point = tuple[float, float]

TARGET_SIDE = 8.0
"""Length of the target's shorter side in the shrunken frame, in pixels."""
MAX_SIDE = 160
"""Largest side of the shrunken frame in pixels; it keeps the search cheaper than one update."""
LOOK_SIDE = 16.0
"""Square root of the target's area in the frame that is shrunken for its looks, in pixels."""
MIN_LOOK_SIDE = 3
"""Smallest side of a look in that frame, in pixels."""
MAX_LOOK_PIXELS = 32_000
"""Largest number of pixels of that frame; it keeps the search at half of an update."""
LOOK_SCALES = (1.0, 0.75, 1.33)
"""Sizes at which the looks are searched, as multiples of the target's last size, unless that is fixed."""
MIN_SECOND_HEIGHT = 0.5
"""Smallest height of the second peak, as a fraction of the highest."""


def second_peak(fused: npt.NDArray[np.float32], target: tuple[float, float]) -> tuple[float, float] | None:
    """Return the displacement (x, y) in cells of the second peak of ``fused``, or None if there is none.

    It is at least a third of the ``target`` (w, h; cells) from the first peak and at least half as high.
    """
    rest, highest = fused.copy(), fused.max()
    x_apart, y_apart = (max(1, int(side / 3)) for side in target)
    y, x = np.unravel_index(int(rest.argmax()), rest.shape)
    rest[max(0, y - y_apart) : y + y_apart + 1, max(0, x - x_apart) : x + x_apart + 1] = 0
    y, x = np.unravel_index(int(rest.argmax()), rest.shape)
    if rest[y, x] < MIN_SECOND_HEIGHT * highest:
        return None
    return float(x - rest.shape[1] // 2), float(y - rest.shape[0] // 2)


class Looks:
    """What the target looked like, and a search of the whole frame for it.

    ``first`` and ``latest`` are gray boxes of (SIDE, SIDE) float32: that of the first frame, and the last one that was
    sure. ``known`` is True once there are any, and ``turn`` counts the searches: each is for one look at one of
    ``scales``, which are multiples of the target's last size.
    """

    def __init__(self, scales: tuple[float, ...] = LOOK_SCALES) -> None:
        self.scales = scales
        self.first: npt.NDArray[np.float32] = np.zeros((SIDE, SIDE), np.float32)
        self.latest: npt.NDArray[np.float32] = np.zeros((SIDE, SIDE), np.float32)
        self.known = False
        self.turn = 0

    def remember(self, box: BoxPixels) -> None:
        """Take the box of a sure frame as the latest look, or as both if there was none."""
        take_pixels(box.gray, box.left, box.top, box.width, box.height, self.latest)
        if not self.known:
            self.first[:], self.known = self.latest, True

    def propose(self, frame: Frame, base_size: tuple[float, float], scale: float) -> tuple[Point, float] | None:
        """Return the center (x, y) and the scale of the box in ``frame`` that is most like a look.

        The likeness is the normalized cross-correlation. None if there is no look, or the box does not fit.
        """
        self.turn += 1
        scale *= self.scales[self.turn // 2 % len(self.scales)]
        (width, height), (w, h) = frame.size, (side * scale for side in base_size)
        shrink = min(1.0, LOOK_SIDE / sqrt(w * h), sqrt(MAX_LOOK_PIXELS / (width * height)))
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        look_size = (max(MIN_LOOK_SIDE, round(w * shrink)), max(MIN_LOOK_SIDE, round(h * shrink)))
        if not self.known or look_size[0] >= size[0] or look_size[1] >= size[1]:
            return None
        look = cv2.resize(self.first if self.turn % 2 else self.latest, look_size, interpolation=cv2.INTER_AREA)
        likeness = cv2.matchTemplate(_shrink(frame, size, to_gray=True), look.astype(np.uint8), cv2.TM_CCOEFF_NORMED)
        row, column = np.unravel_index(int(likeness.argmax()), likeness.shape)
        x, y = float(column) + look_size[0] / 2, float(row) + look_size[1] / 2
        return (x * width / size[0], y * height / size[1]), scale


def propose_by_color(
    color: ColorModel, frame: Frame, base_size: tuple[float, float], scale: float
) -> tuple[float, float]:
    """Return the center (x, y) of the box of the target's size with the highest mean color likelihood in the frame."""
    width, height = frame.size
    w, h = base_size[0] * scale, base_size[1] * scale
    shrink = min(1.0, TARGET_SIDE / min(w, h), MAX_SIDE / max(width, height))
    size = (max(4, round(width * shrink)), max(4, round(height * shrink)))
    pixels = _shrink(frame, size, color.is_gray)
    fx, fy = width / size[0], height / size[1]
    bw, bh = min(max(round(w / fx), 1), size[0]), min(max(round(h / fy), 1), size[1])
    integral = scratch("proposal_integral", (size[1] + 1, size[0] + 1))
    integrate_likelihood(color.bins(pixels), color.lookup, integral)
    rows, columns = np.arange(size[1] - bh + 1), np.arange(size[0] - bw + 1)
    inner = np.empty((len(rows), len(columns)), np.float32)
    box_means(integral, rows, columns, bh, bw, inner)
    row, column = np.unravel_index(int(inner.argmax()), inner.shape)
    return (float(column) + bw / 2) * fx, (float(row) + bh / 2) * fy


def _shrink(frame: Frame, size: tuple[int, int], to_gray: bool) -> Image:
    """Return the whole frame at ``size`` (w, h), gray (h, w) or BGR (h, w, 3)."""
    whole = (0, 0, *frame.size)
    return convert_channels(frame.sample(whole, whole, size), to_gray)
