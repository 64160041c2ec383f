"""Boxes, frames, and the search window with its exact maps between frame, patch and cells.

Coordinates are continuous and 0-based: pixel i covers [i, i + 1). The left edge of a box is ``x``, its center is
``x + w / 2``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, floor, isfinite, sqrt
from operator import index
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from .errors import BadBox, BadImage, RegionTooSmall
from .result import Box

if TYPE_CHECKING:
    from .config import MFCMTConfig

Image = npt.NDArray[np.uint8]
Rect = tuple[int, int, int, int]
"""``(x, y, w, h)`` in whole pixels of the frame."""

MAX_FRAME_SIDE = 1 << 20
"""Largest side of a frame in pixels."""
MIN_BOX_SIDE = 1.0
"""Smallest side of a box in pixels. Smaller boxes are mostly fractions of the frame, given instead of pixels."""
CELL = 4
"""Side of a cell in pixels of the patch (section IV-A)."""


def check_box(box: Iterable[float], frame_size: tuple[int, int]) -> Box:
    """Return the box as four floats.

    Raises
    ------
    BadBox
        Unless the box is four finite numbers, each side is a pixel at least, and a quarter of it lies in the frame.
    """
    try:
        if isinstance(box, str | bytes):
            raise TypeError("text")
        x, y, w, h = (float(v) for v in box)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadBox(f"a box is four numbers x, y, w, h, not {box!r:.99}") from error
    if not all(map(isfinite, (x, y, w, h))):
        raise BadBox("the box is not finite", (x, y, w, h))
    width, height = frame_size
    if not min(w, h) >= MIN_BOX_SIDE:
        shares = " and not shares of the frame" if min(x, y) >= 0 and max(x, y, w, h) <= 1 else ""
        raise BadBox(f"a side of the box is less than a pixel; a box is x, y, w, h in pixels{shares}", (x, y, w, h))
    inside_w = min(x + w, width) - max(x, 0.0)
    inside_h = min(y + h, height) - max(y, 0.0)
    if inside_w <= 0 or inside_h <= 0 or inside_w * inside_h < 0.25 * w * h:
        message = f"less than a quarter of the box lies in the frame of {width}x{height}; a box is x, y, w, h"
        if 0 <= x < w <= width and 0 <= y < h <= height:
            message += ". These numbers fit as corners x1, y1, x2, y2: then w is x2 - x1 and h is y2 - y1"
        raise BadBox(message, (x, y, w, h))
    return x, y, w, h


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame of ``size`` (w, h), of which ``image`` shows the region that begins at ``offset`` (x, y)."""

    image: Image
    offset: tuple[int, int]
    size: tuple[int, int]

    @classmethod
    def of(cls, image: Image, offset: tuple[int, int] = (0, 0), frame_size: tuple[int, int] | None = None) -> Frame:
        """Check an image from a caller and return its frame. Raises BadImage."""
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
            kind = getattr(image, "dtype", type(image).__name__)
            raise BadImage(f"an image is a uint8 array, not {kind}")
        if not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
            raise BadImage(f"an image has shape (H, W) or (H, W, 3), not {image.shape}")
        height, width = image.shape[:2]
        if height < 1 or width < 1:
            raise BadImage(f"an image has at least one pixel, not shape {image.shape}")
        try:
            size = (width, height) if frame_size is None else (index(frame_size[0]), index(frame_size[1]))
            x, y = index(offset[0]), index(offset[1])
        except (TypeError, LookupError) as error:
            raise BadImage(f"offset {offset!r} and frame_size {frame_size!r} are not pairs of integers") from error
        if max(size) > MAX_FRAME_SIDE:
            raise BadImage(f"a side of {max(size)} is more than {MAX_FRAME_SIDE}")
        if x < 0 or y < 0 or x + width > size[0] or y + height > size[1]:
            raise BadImage(f"a region of {width}×{height} at {(x, y)} does not lie in a frame of {size}")
        return cls(image, (x, y), size)

    @property
    def rect(self) -> Rect:
        """The region of the frame that the image shows."""
        return (*self.offset, self.image.shape[1], self.image.shape[0])

    def contains(self, place: tuple[float, float]) -> bool:
        """Return True if ``place`` lies in the frame."""
        return 0 <= place[0] <= self.size[0] and 0 <= place[1] <= self.size[1]

    def require(self, needed: Rect) -> None:
        """Raise RegionTooSmall unless the image shows all of ``needed``."""
        x, y, w, h = self.rect
        if needed[0] < x or needed[1] < y or needed[0] + needed[2] > x + w or needed[1] + needed[3] > y + h:
            raise RegionTooSmall(self.rect, needed)

    def sample(self, rect: Rect, readable: Rect, out_size: tuple[int, int]) -> Image:
        """Return ``rect`` of the frame resized to ``out_size`` (w, h).

        No pixel outside ``readable`` is read; its border pixels repeat there. A large rectangle is subsampled first, so
        that the cost depends on ``out_size`` and not on the rectangle. The rest is resized by a factor below four, for
        which bilinear interpolation averages enough.
        """
        x, y, w, h = rect
        step_x, step_y = max(w // (2 * out_size[0]), 1), max(h // (2 * out_size[1]), 1)
        x0, x1, left, right = _split_samples(x, w, step_x, readable[0], readable[2])
        y0, y1, top, bottom = _split_samples(y, h, step_y, readable[1], readable[3])
        ox, oy = self.offset
        pixels = _columns(self.image[y0 - oy : y1 - oy : step_y], x0 - ox, x1 - ox, step_x)
        if left or right or top or bottom:
            pixels = cv2.copyMakeBorder(  # type: ignore[assignment]
                np.ascontiguousarray(pixels), top, bottom, left, right, cv2.BORDER_REPLICATE
            )
        elif step_x > 1 or step_y > 1:
            pixels = np.ascontiguousarray(pixels)
        return cv2.resize(pixels, out_size, interpolation=cv2.INTER_LINEAR)  # type: ignore[return-value]


def _columns(rows: Image, first: int, last: int, step: int) -> Image:
    """Return ``rows[:, first:last:step]``. OpenCV makes the copy if one is needed, five times as fast as NumPy."""
    if step == 1:
        return rows[:, first:last]
    count = (last - 1 - first) // step + 1
    missing = first + count * step - rows.shape[1]
    wide = rows[:, first : first + count * step]
    if missing > 0:  # after the last column that is taken
        wide = cv2.copyMakeBorder(wide, 0, 0, 0, missing, cv2.BORDER_CONSTANT)  # type: ignore[assignment]
    return cv2.resize(wide, (count, len(rows)), interpolation=cv2.INTER_NEAREST)  # type: ignore[return-value]


def _split_samples(start: int, length: int, step: int, low: int, extent: int) -> tuple[int, int, int, int]:
    """Split the samples start, start + step, … into those inside [low, low + extent) and those outside.

    Returns (first, last, before, after): the slice of the samples inside, and how many are padded on each side.
    """
    count = length // step
    before = min(max(-((start - low) // step), 0), count)
    last_inside = (low + extent - 1 - start) // step
    after = min(max(count - 1 - last_inside, 0), count)
    if before + after >= count:  # no sample is inside: the nearest pixel repeats
        pixel = low if start < low else low + extent - 1
        return pixel, pixel + 1, 0, count - 1
    first = start + before * step
    return first, start + (count - after - 1) * step + 1, before, after


@dataclass(frozen=True, slots=True)
class Patch:
    """The pixels of a search window and its margin, (side, side) or (side, side, 3), and where they come from.

    ``rect`` is the window in whole pixels of the frame, ``center`` (x, y) its exact center, and ``step`` (x, y) the
    frame's pixels per pixel of the patch. Displacements count from this center, not from the unrounded one that was
    asked for.
    """

    pixels: Image
    rect: Rect
    center: tuple[float, float]
    step: tuple[float, float]


class SearchWindow:
    """The search window of one target: its size at scale 1 and the grids that lie on it.

    Attributes
    ----------
    extent : (float, float)
        Size (w, h) in pixels of the frame, at scale 1.
    patch_size : int
        Side of the square patch that the window is resized to. The aspect ratio is not kept, so that every target has
        the same grid and the same cost.
    margin : int
        Pixels of the patch that are cropped around the window on each side, for other windows nearby.
    cells : int
        Number of cells per side.
    target : (float, float)
        Size (w, h) of the target in cells.
    reach : (int, int)
        Largest displacement (x, y) in cells.
    """

    def __init__(self, config: MFCMTConfig, base_size: tuple[float, float]) -> None:
        w, h = base_size
        k = config.search_area_scale
        if config.window == "target":
            self.extent = (k * w, k * h)
        elif config.window == "context":
            pad = (k - 1) * (w + h) / 2
            self.extent = (w + pad, h + pad)
        else:
            self.extent = (k * sqrt(w * h), k * sqrt(w * h))
        self.base_size = base_size
        self.patch_size = config.patch_size
        self.margin = config.patch_size // 8 if config.learn_within else 0
        self.cells = config.patch_size // CELL
        self.target = (self.cells * w / self.extent[0], self.cells * h / self.extent[1])
        self.reach = (self._reach(self.target[0]), self._reach(self.target[1]))

    def _reach(self, target_cells: float) -> int:
        """Return the largest displacement in cells at which the target still lies in the window, but at least two."""
        return max(2, min(floor((self.cells - target_cells) / 2), (self.cells - 1) // 2))

    def rect(self, center: tuple[float, float], scale: float, grow: float = 1.0) -> Rect:
        """Return the window around ``center``, times ``grow``, in whole pixels and not clipped to the frame."""
        w = max(2, round(self.extent[0] * scale * grow))
        h = max(2, round(self.extent[1] * scale * grow))
        return floor(center[0] - w / 2 + 0.5), floor(center[1] - h / 2 + 0.5), w, h

    def crop(self, frame: Frame, readable: Rect, center: tuple[float, float], scale: float) -> Patch:
        """Return the window's pixels at ``center`` and ``scale``. No pixel outside ``readable`` is read."""
        side = self.patch_size + 2 * self.margin
        x, y, w, h = rect = self.rect(center, scale, side / self.patch_size)
        pixels = frame.sample(rect, readable, (side, side))
        return Patch(pixels, rect, (x + w / 2, y + h / 2), (w / side, h / side))

    def neighbor(self, center: tuple[float, float], scale: float, side: int) -> tuple[float, float]:
        """Return the center of the window half a window to the left (``side`` 0), up (1), right (2) or down (3)."""
        half = self.extent[side % 2] * scale / 2
        step = half if side >= 2 else -half
        return (center[0] + step, center[1]) if side % 2 == 0 else (center[0], center[1] + step)


def convert_channels(pixels: Image, to_gray: bool) -> Image:
    """Return the pixels as gray (H, W) or BGR (H, W, 3); the array itself if it is so already."""
    if to_gray == (pixels.ndim == 2):
        return pixels
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY if to_gray else cv2.COLOR_GRAY2BGR)  # type: ignore[return-value]


def clip_rect(rect: Rect, frame_size: tuple[int, int]) -> Rect:
    """Return the part of ``rect`` inside the frame, at least one pixel."""
    x, y, w, h = rect
    x0, y0 = min(max(x, 0), frame_size[0] - 1), min(max(y, 0), frame_size[1] - 1)
    x1, y1 = max(min(x + w, frame_size[0]), x0 + 1), max(min(y + h, frame_size[1]), y0 + 1)
    return x0, y0, x1 - x0, y1 - y0


def grow_rect(rect: Rect, by_x: float, by_y: float) -> Rect:
    """Return ``rect`` with ``by_x`` and ``by_y`` pixels more on each side, rounded outwards."""
    x, y, w, h = rect
    gx, gy = ceil(by_x), ceil(by_y)
    return x - gx, y - gy, w + 2 * gx, h + 2 * gy
