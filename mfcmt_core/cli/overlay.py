"""Draw a result into its frame: box and status, and the three reliability scores as a strip below."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
import numpy.typing as npt

from ..result import TrackResult

Image = npt.NDArray[np.uint8]

COLORS = {"tracking": (96, 200, 64), "uncertain": (32, 176, 250), "lost": (64, 64, 235)}
INK, PAPER, FAINT = (225, 225, 225), (28, 26, 24), (88, 84, 80)
ROW, LABEL, TOP = 28, 150, 1.6  # px of a score's row and of its label; the score at a row's upper edge
NAMES = ("fused", "template", "statistical")


class Overlay:
    """Draws results over frames. ``thresholds`` are the γ of the three tests, drawn as lines."""

    def __init__(self, thresholds: tuple[float, float, float]) -> None:
        self._thresholds = thresholds
        self._past: deque[TrackResult] = deque(maxlen=4096)

    def draw(self, frame: Image, result: TrackResult) -> Image:
        """Return a new BGR image: the frame with box, status and confidence, and three rows of scores below it."""
        self._past.append(result)
        height, width = frame.shape[:2]
        full = np.full((height + 3 * ROW, width, 3), PAPER, np.uint8)
        full[:height] = frame if frame.ndim == 3 else frame[..., None]
        self._box(full[:height], result)
        for i, name in enumerate(NAMES):
            self._row(full[height + i * ROW : height + (i + 1) * ROW], name, self._thresholds[i])
        return full

    @staticmethod
    def _box(image: Image, result: TrackResult) -> None:
        color = COLORS[result.status]
        x, y, w, h = result.box
        near, far = (round(x * 16), round(y * 16)), (round((x + w - 1) * 16), round((y + h - 1) * 16))
        cv2.rectangle(image, near, far, color, 2, cv2.LINE_AA, shift=4)
        text = f"{result.status} {result.confidence:.2f}"
        (tw, th), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
        left = int(np.clip(x, 0, max(0, image.shape[1] - tw - 8)))
        base = int(np.clip(y - 6, th + 6, image.shape[0] - 6))
        cv2.rectangle(image, (left, base - th - 5), (left + tw + 7, base + 4), color, -1)
        cv2.putText(image, text, (left + 4, base), cv2.FONT_HERSHEY_SIMPLEX, 0.5, PAPER, 1, cv2.LINE_AA)

    def _row(self, row: Image, name: str, threshold: float) -> None:
        width = row.shape[1]
        space = max(0, width - LABEL - 4)
        past = list(self._past)[-(space // 2) :] if space else []
        row[0], now = FAINT, "-"
        for k, result in enumerate(past):
            if result.scores and result.flags:
                score = getattr(result.scores, name)
                high = round(min(max(score, 0.0), TOP) / TOP * (ROW - 4))
                color = COLORS["tracking" if getattr(result.flags, name) else "lost"]
                row[ROW - 2 - high : ROW - 2, LABEL + 2 * k : LABEL + 2 * k + 2] = color
                now = f"{score:.2f}"
        row[ROW - 2 - round(threshold / TOP * (ROW - 4)), LABEL : width - 4 : 2] = INK
        for text, at in ((name, 6), (now, LABEL - 44)):
            cv2.putText(row, text, (at, ROW - 9), cv2.FONT_HERSHEY_SIMPLEX, 0.42, INK, 1, cv2.LINE_AA)
