"""Results as rows of plain values: what travels from a lane and what the front keeps of the past."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from mfcmt_core import Flags, Scores, TrackResult

Rect = tuple[int, int, int, int]


def to_row(tid: int, said: TrackResult) -> list[Any]:
    """``[id, box, status, reliable, flags, scores, psr, updated, scale]``."""
    flags, scores = said.flags, said.scores
    return [
        tid,
        said.box,
        said.status,
        said.reliable,
        flags and (flags.fused, flags.template, flags.statistical),
        scores and (scores.fused, scores.template, scores.statistical),
        said.psr,
        said.updated,
        said.scale,
    ]


def from_row(row: list[Any]) -> TrackResult:
    """The result that :func:`to_row` wrote."""
    _, (x, y, w, h), status, reliable, flags, scores, psr, updated, scale = row
    return TrackResult(
        (x, y, w, h),
        status,
        reliable,
        flags and Flags(*flags),
        scores and Scores(*scores),
        psr,
        updated,
        scale,
    )


def map_images(maps: dict[str, npt.NDArray[np.float32]] | None) -> dict[str, bytes]:
    """Response maps as grey PNG images, the peak of each at 255."""
    images = {}
    for name, values in (maps or {}).items():
        peak = float(values.max()) or 1.0
        levels = np.clip(np.rint(values * (255 / peak)), 0, 255).astype(np.uint8)
        images[name] = cv2.imencode(".png", levels)[1].tobytes()
    return images


def union(rects: Iterable[Rect]) -> Rect | None:
    """The smallest rectangle around all; None around none."""
    corners = [(x, y, x + w, y + h) for x, y, w, h in rects]
    if not corners:
        return None
    left, top = min(c[0] for c in corners), min(c[1] for c in corners)
    right, bottom = max(c[2] for c in corners), max(c[3] for c in corners)
    return left, top, right - left, bottom - top


def covers(outer: Rect, inner: Rect) -> bool:
    """Whether no pixel of ``inner`` is outside ``outer``."""
    return (
        outer[0] <= inner[0]
        and outer[1] <= inner[1]
        and outer[0] + outer[2] >= inner[0] + inner[2]
        and outer[1] + outer[3] >= inner[1] + inner[3]
    )
