"""Draw results into their frame: boxes in the colours of their targets, and the confidence of each as a strip below."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from ..exports import Row, Target

Image = npt.NDArray[np.uint8]

COLORS = (
    (96, 200, 64), (250, 160, 60), (60, 170, 250), (220, 90, 200), (70, 220, 230), (110, 110, 255), (230, 220, 90),
)  # fmt: skip
"""The targets' colours, BGR; an eighth target has the first one again."""
DASHES = {"tracking": (1, 0), "uncertain": (8, 6), "lost": (2, 6)}
"""Pixels drawn and left out in the edge of a box by status."""
INK, PAPER, FAINT = (225, 225, 225), (28, 26, 24), (88, 84, 80)
ROW, LABEL = 28, 150  # px of a target's row and of its label
MOST_ROWS = 6


class Overlay:
    """Draws results over frames. ``targets`` are all that will be drawn; the first six have a row of confidence."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self._order = {target: order for order, target in enumerate(targets)}
        self._strips = list(targets)[:MOST_ROWS]
        self._past: dict[Target, deque[Row]] = {target: deque(maxlen=4096) for target in self._strips}

    def draw(self, frame: Image, rows: Sequence[Row]) -> Image:
        """Return a new BGR image: the frame, (H, W, 3), with the boxes, and the rows of confidence below it."""
        height, width = frame.shape[:2]
        full = np.full((height + len(self._strips) * ROW, width, 3), PAPER, np.uint8)
        full[:height] = frame if frame.ndim == 3 else frame[..., None]
        for row in rows:
            if row.target in self._past:
                self._past[row.target].append(row)
            self._box(full[:height], row)
        for i, target in enumerate(self._strips):
            self._row(full[height + i * ROW : height + (i + 1) * ROW], target)
        return full

    def _color(self, target: Target) -> tuple[int, int, int]:
        return COLORS[self._order[target] % len(COLORS)]

    def _box(self, image: Image, row: Row) -> None:
        color = self._color(row.target)
        x, y, w, h = row.result.box
        corners = [(x, y), (x + w - 1, y), (x + w - 1, y + h - 1), (x, y + h - 1), (x, y)]
        for start, end in pairwise(corners):
            _line(image, start, end, color, *DASHES[row.result.status])
        name = "" if len(self._order) == 1 else f"{row.target.name} "
        text = f"{name}{row.result.status} {row.result.confidence:.2f}"
        (tw, th), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
        left = int(np.clip(x, 0, max(0, image.shape[1] - tw - 8)))
        base = int(np.clip(y - 6, th + 6, max(th + 6, image.shape[0] - 6)))
        cv2.rectangle(image, (left, base - th - 5), (left + tw + 7, base + 4), color, -1)
        cv2.putText(image, text, (left + 4, base), cv2.FONT_HERSHEY_SIMPLEX, 0.5, PAPER, 1, cv2.LINE_AA)

    def _row(self, strip: Image, target: Target) -> None:
        """Draw the confidence of the last frames as columns, 2 pixels each: full for tracking, dim for less."""
        width, color = strip.shape[1], self._color(target)
        space = max(0, width - LABEL - 4)
        past = list(self._past[target])[-(space // 2) :] if space >= 2 else []
        strip[0], now = FAINT, "-"
        for k, row in enumerate(past):
            high = round(row.result.confidence * (ROW - 4))
            shade = {"tracking": 1.0, "uncertain": 0.6, "lost": 0.3}[row.result.status]
            at = LABEL + 2 * k
            strip[ROW - 2 - high : ROW - 2, at : at + 2] = [round(shade * c) for c in color]
            now = f"{row.result.confidence:.2f}"
        strip[ROW - 2 - (ROW - 4) // 2, LABEL : width - 4 : 2] = INK
        label = "confidence" if len(self._order) == 1 else target.name[:10]
        for text, at in ((label, 6), (now, LABEL - 44)):
            cv2.putText(strip, text, (at, ROW - 9), cv2.FONT_HERSHEY_SIMPLEX, 0.42, INK, 1, cv2.LINE_AA)


def _line(
    image: Image,
    start: tuple[float, float],
    end: tuple[float, float],
    color: tuple[int, int, int],
    drawn: float,
    left_out: float,
) -> None:
    """Draw a line of two pixels, in dashes if some of it is left out."""
    a, b = np.array(start), np.array(end)
    length = float(np.hypot(*(b - a)))
    step = drawn + left_out if left_out else max(length, 1.0)
    for at in np.arange(0.0, max(length, 1e-6), step):
        stop = min(at + (drawn if left_out else length), length)
        points = [tuple(np.round(16 * (a + (b - a) * s / max(length, 1e-6))).astype(int)) for s in (at, stop)]
        near, far = (tuple(int(v) for v in np.clip(p, -(1 << 20), 1 << 20)) for p in points)
        cv2.line(image, near, far, color, 2, cv2.LINE_AA, shift=4)
