"""Other places for a target: the second peak of the fused map, and the place in the frame whose colors fit best."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .color import ColorModel
from .geometry import Frame
from .kernels.color import box_means, integrate_likelihood
from .workspace import scratch

TARGET_SIDE = 8.0
"""Length of the target's shorter side in the shrunken frame, in pixels."""
MAX_SIDE = 160
"""Largest side of the shrunken frame in pixels; it keeps the search cheaper than one update."""
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


def propose(color: ColorModel, frame: Frame, base_size: tuple[float, float], scale: float) -> tuple[float, float]:
    """Return the center (x, y) of the box of the target's size with the highest mean color likelihood in the frame."""
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
