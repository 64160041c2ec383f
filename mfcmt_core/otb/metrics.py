"""Overlap, center error and the curves made of them, by the rules of the OTB toolkit (Wu et al., 2013).

All boxes are ``(N, 4)`` arrays of ``x, y, w, h`` in pixels; the origin cancels out where both sides share it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SUCCESS_THRESHOLDS: Array = np.linspace(0.0, 1.0, 21)
"""Overlap; a frame succeeds when its overlap is strictly greater."""

PRECISION_THRESHOLDS: Array = np.arange(51.0)
"""Center error in pixels; a frame is precise when its error is not greater."""

NORM_PRECISION_THRESHOLDS: Array = np.arange(51) / 100.0
"""Center error over the target's size (TrackingNet, LaSOT)."""

PRECISION_AT = 20
"""The precision score is the curve at 20 pixels."""

NORM_PRECISION_AT = 20
"""The normalized precision score is the curve at 0.2: index 20."""


def overlap(boxes: Array, truth: Array) -> Array:
    """Return intersection over union, ``(N,)`` in [0, 1]; 0 where the union has no area."""
    corner = np.maximum(boxes[:, :2], truth[:, :2])
    opposite = np.minimum(boxes[:, :2] + boxes[:, 2:], truth[:, :2] + truth[:, 2:])
    intersection = np.prod(np.maximum(opposite - corner, 0.0), axis=1)
    union = np.prod(boxes[:, 2:], axis=1) + np.prod(truth[:, 2:], axis=1) - intersection
    result: Array = np.divide(intersection, union, out=np.zeros_like(union), where=union > 0)
    return result


def center_error(boxes: Array, truth: Array) -> Array:
    """Return the distance of the centers ``x + (w - 1) / 2`` in pixels, ``(N,)``."""
    return np.asarray(np.linalg.norm(_centers(boxes) - _centers(truth), axis=1))


def normalized_center_error(boxes: Array, truth: Array) -> Array:
    """Return the distance of the centers, each axis over the target's size, ``(N,)``; infinite for a size of 0."""
    offset = _centers(boxes) - _centers(truth)
    size = truth[:, 2:]
    scaled = np.divide(offset, size, out=np.full_like(offset, np.inf), where=size > 0)
    return np.asarray(np.linalg.norm(scaled, axis=1))


def success_curve(overlaps: Array) -> Array:
    """Return the share of frames whose overlap is greater than each of the 21 thresholds, ``(21,)``."""
    return np.asarray((overlaps[:, None] > SUCCESS_THRESHOLDS).mean(axis=0))


def precision_curve(errors: Array, thresholds: Array = PRECISION_THRESHOLDS) -> Array:
    """Return the share of frames whose error is at most each threshold, ``(51,)``."""
    return np.asarray((errors[:, None] <= thresholds).mean(axis=0))


def _centers(boxes: Array) -> Array:
    return np.asarray(boxes[:, :2] + (boxes[:, 2:] - 1.0) / 2.0)
