"""Results of the tracker as rows of plain values, response maps as images, and rectangles of pixels."""

from __future__ import annotations

from collections.abc import Iterable
from operator import attrgetter

import cv2
import numpy as np
import numpy.typing as npt

from mfcmt_core import Flags, Scores, TrackResult

from ..protocol.target import ROW_FIELDS, Row, complete

Rect = tuple[int, int, int, int]
"""``(x, y, w, h)`` in whole pixels of the frame."""

# A row's values but the first, the id, are the attributes of a result that have the same names.
_values = attrgetter(*ROW_FIELDS[1:])
_parts = attrgetter("fused", "template", "statistical")
_FLAGS, _SCORES = ROW_FIELDS.index("flags"), ROW_FIELDS.index("scores")


def to_row(target_id: int, result: TrackResult) -> Row:
    """Return the row of a result; see :mod:`service.protocol.target`."""
    row = [target_id, *_values(result)]
    for at in (_FLAGS, _SCORES):
        if row[at] is not None:
            row[at] = _parts(row[at])
    return row


def from_row(row: Row) -> TrackResult:
    """Return the result that :func:`to_row` wrote, now or in an earlier version."""
    values = dict(zip(ROW_FIELDS, complete(row), strict=True))
    del values["id"]
    if values["confidence"] is None:  # an earlier version kept the row; nothing reads it from there
        del values["confidence"]
    flags, scores = values["flags"], values["scores"]
    x, y, w, h = values["box"]
    return TrackResult(
        **values | {"box": (x, y, w, h), "flags": flags and Flags(*flags), "scores": scores and Scores(*scores)}
    )


def map_images(maps: dict[str, npt.NDArray[np.float32]] | None) -> dict[str, bytes]:
    """Return response maps as gray PNG images in which the peak of each map has the value 255."""
    images = {}
    for name, values in (maps or {}).items():
        peak = float(values.max()) or 1.0
        levels = np.clip(np.rint(values * (255 / peak)), 0, 255).astype(np.uint8)
        images[name] = cv2.imencode(".png", levels)[1].tobytes()
    return images


def union(rects: Iterable[Rect]) -> Rect | None:
    """Return the smallest rectangle that covers all of ``rects``, None if there are none."""
    corners = [(x, y, x + w, y + h) for x, y, w, h in rects]
    if not corners:
        return None
    left, top = min(c[0] for c in corners), min(c[1] for c in corners)
    right, bottom = max(c[2] for c in corners), max(c[3] for c in corners)
    return left, top, right - left, bottom - top


def covers(outer: Rect, inner: Rect) -> bool:
    """Return whether every pixel of ``inner`` lies in ``outer``."""
    return (
        outer[0] <= inner[0]
        and outer[1] <= inner[1]
        and outer[0] + outer[2] >= inner[0] + inner[2]
        and outer[1] + outer[3] >= inner[1] + inner[3]
    )
