"""Where else to look: for a doubtful target at the map's other peak, for a lost one where its colours fit best."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .color import ColorModel
from .geometry import Frame
from .kernels.color import box_means, integrate_likelihood
from .workspace import scratch

TARGET_SIDE = 8.0
"""Pixels that the target's shorter side keeps in the shrunken frame."""
MAX_SIDE = 160
"""Pixels of the shrunken frame's longer side at most, so that the search costs less than one update."""
MIN_SECOND_HEIGHT = 0.5
"""Of the highest peak, that another one must have."""


def second_peak(fused: npt.NDArray[np.float32], target: tuple[float, float]) -> tuple[float, float] | None:
    """Displacement (x, y) in cells of the next highest peak of ``fused``, a third of the target (w, h) apart."""
    rest, highest = fused.copy(), fused.max()
    x_apart, y_apart = (max(1, int(side / 3)) for side in target)
    y, x = np.unravel_index(int(rest.argmax()), rest.shape)
    rest[max(0, y - y_apart) : y + y_apart + 1, max(0, x - x_apart) : x + x_apart + 1] = 0
    y, x = np.unravel_index(int(rest.argmax()), rest.shape)
    if rest[y, x] < MIN_SECOND_HEIGHT * highest:
        return None
    return float(x - rest.shape[1] // 2), float(y - rest.shape[0] // 2)


def propose(color: ColorModel, frame: Frame, base_size: tuple[float, float], scale: float) -> tuple[float, float]:
    """Centre of the box of the target's size whose mean likelihood exceeds its surroundings' most."""
    width, height = frame.size
    w, h = base_size[0] * scale, base_size[1] * scale
    shrink = min(1.0, TARGET_SIDE / min(w, h), MAX_SIDE / max(width, height))
    size = (max(4, round(width * shrink)), max(4, round(height * shrink)))
    pixels = frame.sample((0, 0, width, height), (0, 0, width, height), size)
    if color.is_gray and pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)  # type: ignore[assignment]
    elif not color.is_gray and pixels.ndim == 2:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)  # type: ignore[assignment]
    fx, fy = width / size[0], height / size[1]
    bw, bh = min(max(round(w / fx), 1), size[0]), min(max(round(h / fy), 1), size[1])
    integral = scratch("proposal_integral", (size[1] + 1, size[0] + 1))
    integrate_likelihood(color.bins(pixels), color.lookup, integral)
    rows, columns = np.arange(size[1] - bh + 1), np.arange(size[0] - bw + 1)
    inner = np.empty((len(rows), len(columns)), np.float32)
    box_means(integral, rows, columns, bh, bw, inner)
    row, column = np.unravel_index(int(inner.argmax()), inner.shape)
    return (float(column) + bw / 2) * fx, (float(row) + bh / 2) * fy
