"""What every export is made from: rows, and what is known of the clip."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..result import Box, TrackResult


@dataclass(frozen=True, slots=True)
class Target:
    """What is tracked: a number from 1, a name, and the class of such things."""

    id: int = 1
    name: str = "target"
    kind: str = "object"


@dataclass(frozen=True, slots=True)
class Row:
    """A target in one frame.

    ``frame`` counts from 0; ``time_s`` is the frame's time in seconds, None where the source has none. ``keyframe`` is
    the number of the frame with a known box from which the box was tracked, None unless several were given.
    """

    frame: int
    time_s: float | None
    target: Target
    result: TrackResult
    keyframe: int | None = None


@dataclass(frozen=True, slots=True)
class Clip:
    """A source: its name, the size of its frames in pixels, its frames a second, and the images of a folder by name."""

    name: str
    width: int
    height: int
    fps: float
    images: tuple[str, ...] = ()

    def image(self, frame: int) -> str:
        """Return the file name of a frame: of an image of the folder, or of one cut from the video."""
        if self.images:
            return self.images[frame]
        return f"{self.name.rpartition('.')[0] or self.name}_{frame:06}.jpg"

    def inside(self, box: Box) -> Box | None:
        """Return the part of a box that lies in the frame, None if there is none."""
        left, top = max(box[0], 0.0), max(box[1], 0.0)
        right, bottom = min(box[0] + box[2], float(self.width)), min(box[1] + box[3], float(self.height))
        return (left, top, right - left, bottom - top) if right > left and bottom > top else None


def seen(clip: Clip, row: Row) -> Box | None:
    """Return the visible part of the target's box, None while the target is lost or out of the picture."""
    return None if row.result.status == "lost" else clip.inside(row.result.box)


def by_target(rows: Iterable[Row]) -> dict[Target, list[Row]]:
    """Return the rows of each target, in the order in which the targets began."""
    tracks: dict[Target, list[Row]] = {}
    for row in rows:
        tracks.setdefault(row.target, []).append(row)
    return tracks
