"""The models of one target, and the windows of a frame that they observe."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from .color import Bins, ColorModel
from .confidence import BoxPixels, Confidence
from .config import MFCMTConfig
from .features import usable_cues
from .fourier import Spectra
from .geometry import CELL, Frame, Image, Patch, Rect, SearchWindow, convert_channels
from .redetection import LOOK_SCALES, Looks
from .reliability import Reliability
from .result import Box
from .scale import ScaleModel
from .template import TemplateModel
from .workspace import scratch

GRAY_TOLERANCE = 1
"""Largest difference between the channels of a gray sequence, in gray levels."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Crop:
    """A patch with its margin, prepared once for all the windows that are observed in it.

    ``pixels`` are the patch's in the channels of the models, ``gray`` is their gray version for the features of
    shape, and ``bins`` are the color bins (empty without a color model). ``scale`` is the target's scale at which
    the patch was taken.
    """

    patch: Patch
    scale: float
    pixels: Image
    gray: Image
    bins: Bins

    def offset(self, place: Point) -> Point:
        """Return the pixels (x, y) of the patch from its middle to ``place`` in the frame."""
        (x, y), (sx, sy) = self.patch.center, self.patch.step
        return (place[0] - x) / sx, (place[1] - y) / sy


@dataclass(frozen=True, slots=True)
class Observation:
    """One search window in a crop, and its features for the models.

    ``shift`` (x, y) is where the window lies: whole pixels of the patch from the middle of the crop. ``spectra`` are
    empty without a template model, ``bins`` without a color model.
    """

    crop: Crop
    shift: tuple[int, int]
    spectra: Spectra
    bins: Bins

    def offset(self, place: Point) -> Point:
        """Return the cells (x, y) from the middle of the window to ``place`` in the frame."""
        x, y = self.crop.offset(place)
        return (x - self.shift[0]) / CELL, (y - self.shift[1]) / CELL

    def is_central(self, place: Point) -> bool:
        """Return True if ``place`` is within a cell of the middle of the window."""
        return max(map(abs, self.offset(place))) <= 1

    def place_at(self, displacement: Point) -> Point:
        """Return the place in the frame that is ``displacement`` (x, y) cells from the middle of the window."""
        (x, y), (step_x, step_y), (shift_x, shift_y) = self.crop.patch.center, self.crop.patch.step, self.shift
        return x + (displacement[0] * CELL + shift_x) * step_x, y + (displacement[1] * CELL + shift_y) * step_y


class Target:
    """The models of one target and where it is: the state of a tracker.

    ``center`` (x, y) and ``scale`` are those of the last frame, ``last_reliable_center`` is that of the last reliable
    one. ``runner_up`` is a place whose peak was higher than the target's in the last frame, but not high enough to
    move there; the next frame probes it again.
    """

    def __init__(self, config: MFCMTConfig, base_size: Point, is_gray: bool) -> None:
        self.is_gray = is_gray
        self.base_size = base_size
        self.center: Point = (0.0, 0.0)
        self.last_reliable_center: Point = (0.0, 0.0)
        self.runner_up: Point | None = None
        self.scale = 1.0
        self.search_window = SearchWindow(config, base_size)
        cues = usable_cues(config, is_gray)
        self.template = TemplateModel(config, self.search_window, is_gray) if cues else None
        has_color = config.color_histogram or not cues
        self.color = ColorModel(config, self.search_window, is_gray) if has_color else None
        self.scale_model = ScaleModel(config, base_size) if config.num_scales > 1 else None
        self.reliability = Reliability(config)
        self.confidence = Confidence()
        self.looks = Looks(LOOK_SCALES if self.scale_model else (1.0,))
        self.learn_within = config.learn_within
        self.largest_step = config.scale_step * (1 + 1e-6)  # rounding
        names = (self.template.names if self.template else ()) + (("statistical",) if self.color else ())
        self.map_names: tuple[str, ...] = names
        self.map_weights = np.ones(len(names), np.float32)
        if self.color:
            self.map_weights[-1] = config.statistical_weight if cues else 1

    def observe(self, frame: Frame, readable: Rect, place: Point, crop: Crop | None = None) -> Observation:
        """Return the window around ``place`` with its features (lines 2–4 of Algorithm 1).

        The window is taken from ``crop`` if that covers it, otherwise from a new crop around ``place``. Pixels
        outside ``readable`` are not read.
        """
        margin = self.search_window.margin
        if crop is None or not self._covers(crop, place):
            crop = self._crop(frame, readable, place)
        x, y = (min(max(round(pixels), -margin), margin) for pixels in crop.offset(place))
        size = self.search_window.patch_size
        part = (slice(y + margin, y + margin + size), slice(x + margin, x + margin + size))
        pixels = np.ascontiguousarray(crop.pixels[part])
        gray = pixels if self.is_gray else np.ascontiguousarray(crop.gray[part])
        return Observation(
            crop,
            (x, y),
            self.template.spectra(pixels, gray) if self.template else np.empty(0, np.complex64),
            np.ascontiguousarray(crop.bins[part]) if self.color else crop.bins,
        )

    def _crop(self, frame: Frame, readable: Rect, place: Point) -> Crop:
        patch = self.search_window.crop(frame, readable, place, self.scale)
        pixels = convert_channels(patch.pixels, self.is_gray)
        gray = pixels if self.is_gray else convert_channels(pixels, to_gray=True)
        return Crop(patch, self.scale, pixels, gray, self.color.bins(pixels) if self.color else np.empty(0, np.uint16))

    def _covers(self, crop: Crop, place: Point) -> bool:
        """Return True if ``crop`` covers the window at ``place``. Without a margin it must be the very same window."""
        if not self.learn_within:
            return self.search_window.rect(place, self.scale) == crop.patch.rect
        return self._is_near_scale(crop.scale) and max(map(abs, crop.offset(place))) <= self.search_window.margin

    def can_learn_from(self, observation: Observation) -> bool:
        """Return True if ``observation`` is near enough to the target's center and scale for the models to learn it."""
        if not self.learn_within:
            return self._covers(observation.crop, self.center)
        near_scale = self._is_near_scale(observation.crop.scale)
        return near_scale and max(map(abs, observation.offset(self.center))) <= self.learn_within

    def can_reuse(self, observation: Observation, crop: Crop) -> bool:
        """Return True if :meth:`observe` at the target's center, from ``crop`` or anew, would give ``observation``."""
        return self.can_learn_from(observation) and (observation.crop is crop or observation.crop.scale == self.scale)

    def _is_near_scale(self, scale: float) -> bool:
        """Return True if the target's scale is at most one step from ``scale``."""
        return 1 / self.largest_step <= self.scale / scale <= self.largest_step

    def learn(self, observation: Observation, first: bool = False) -> None:
        """Update the template and the color model from a window near the target (line 11 of Algorithm 1)."""
        offset = observation.offset(self.center) if self.learn_within else (0.0, 0.0)
        if self.template:
            self.template.learn(observation.spectra, offset, None if first else self.reliability.learned)
        if self.color:
            self.color.learn(observation.bins, offset, first)

    def maps(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return the scratch arrays of the single maps (maps, rows, columns) and of the fused one (rows, columns)."""
        reach_x, reach_y = self.search_window.reach
        shape = (2 * reach_y + 1, 2 * reach_x + 1)
        return scratch("responses", (len(self.map_names), *shape)), scratch("fused", shape)

    def box_pixels(self, crop: Crop, center: Point, frame_size: tuple[int, int]) -> BoxPixels:
        """Return the target's box around ``center`` in the pixels of ``crop``; ``frame_size`` is (w, h)."""
        (width, height), (step_x, step_y) = self.size, crop.patch.step
        (x, y), (offset_x, offset_y) = center, crop.offset(center)
        inside_x = min(x + width / 2, frame_size[0]) - max(x - width / 2, 0.0)
        inside_y = min(y + height / 2, frame_size[1]) - max(y - height / 2, 0.0)
        rows, columns = crop.gray.shape
        w, h = width / step_x, height / step_y
        return BoxPixels(
            gray=crop.gray,
            bins=crop.bins if self.color else (crop.gray >> 3).astype(np.uint16),
            channels=3 if self.color and not self.is_gray else 1,
            left=columns / 2 + offset_x - w / 2,
            top=rows / 2 + offset_y - h / 2,
            width=w,
            height=h,
            inside=max(inside_x, 0.0) * max(inside_y, 0.0) / (width * height),
        )

    @property
    def size(self) -> tuple[float, float]:
        """The width and height of the box at the present scale, in pixels of the frame."""
        return self.base_size[0] * self.scale, self.base_size[1] * self.scale

    @property
    def box(self) -> Box:
        """The box (x, y, w, h) at the present center and scale."""
        w, h = self.size
        return self.center[0] - w / 2, self.center[1] - h / 2, w, h


def is_gray(pixels: Image) -> bool:
    """Return True if the image has one channel, or three that differ by no more than rounding."""
    if pixels.ndim == 2:
        return True
    blue, green, red = cv2.split(pixels)
    worst = max(int(cv2.absdiff(blue, green).max()), int(cv2.absdiff(green, red).max()))
    return worst <= GRAY_TOLERANCE
