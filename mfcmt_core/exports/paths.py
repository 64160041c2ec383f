"""Thinned paths, as editors of video annotations want them: keyframes, and from where on the target is away."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ..result import Box
from .rows import Clip, Row, seen
from .thin import keyframes


class Point(NamedTuple):
    """A keyframe: from its frame on the target is in the box, or away. Between two with it the box moves on a line."""

    frame: int
    time_s: float | None
    box: Box
    present: bool


def points(clip: Clip, rows: list[Row], tolerance: float) -> Iterator[Point]:
    """Yield the keyframes of one target's rows, thinned by ``tolerance`` in pixels.

    Where the target is lost or out of the picture, its last box is repeated as away; nothing of it is there before
    the first frame in which it is seen.
    """
    stretch: list[tuple[Row, Box]] = []
    for row in rows:
        box = seen(clip, row)
        if box is not None:
            stretch.append((row, box))
        elif stretch:
            yield from _thinned(stretch, tolerance)
            yield Point(row.frame, row.time_s, stretch[-1][1], present=False)
            stretch = []
    if stretch:
        yield from _thinned(stretch, tolerance)


def _thinned(stretch: list[tuple[Row, Box]], tolerance: float) -> Iterator[Point]:
    kept = keyframes([row.frame for row, _ in stretch], [box for _, box in stretch], tolerance)
    for index in kept:
        row, box = stretch[index]
        yield Point(row.frame, row.time_s, box, present=True)
