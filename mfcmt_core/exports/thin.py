"""Choose the keyframes of a path: the frames that a person needs to edit, since others lie on lines between them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def keyframes(frames: npt.ArrayLike, boxes: npt.ArrayLike, tolerance: float) -> list[int]:
    """Return the places of as few rows as needed so that lines between them miss no edge of a box by more.

    Parameters
    ----------
    frames : array of int, shape (N,)
        Frame numbers, ascending.
    boxes : array of float, shape (N, 4)
        x, y, w, h in pixels.
    tolerance : float
        Distance in pixels that an edge (left, top, right, bottom) may be off.

    Returns
    -------
    list of int
        Ascending indices into ``frames``, with the first and the last.
    """
    times = np.asarray(frames, float)
    edges = np.array(boxes, float).reshape(-1, 4)
    edges[:, 2:] += edges[:, :2]
    kept = {0, len(times) - 1}
    spans = [(0, len(times) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        share = ((times[first + 1 : last] - times[first]) / (times[last] - times[first]))[:, None]
        line = edges[first] + share * (edges[last] - edges[first])
        errors = np.abs(edges[first + 1 : last] - line).max(axis=1)
        worst = int(errors.argmax())
        if errors[worst] > tolerance:
            kept.add(first + 1 + worst)
            spans += [(first, first + 1 + worst), (first + 1 + worst, last)]
    return sorted(kept) if len(times) else []
