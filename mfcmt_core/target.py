"""The models of one target, and what they see of a frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from .color import Bins, ColorModel
from .config import MFCMTConfig
from .fourier import Spectra
from .geometry import CELL, Frame, Image, Patch, Rect, SearchWindow
from .reliability import Reliability
from .result import Box
from .scale import ScaleModel
from .template import TemplateModel
from .workspace import scratch

GREY_TOLERANCE = 1
"""Grey levels that the channels of a grey sequence may differ by."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Cut:
    """The search window and its margin at one place of one frame, and what is computed once for all its pixels.

    ``pixels`` are the patch's in the models' channels, ``gray`` is what features of shape look at; ``bins`` are
    empty where there is no model of colours. ``scale`` is the target's at which it was cut.
    """

    patch: Patch
    scale: float
    pixels: Image
    gray: Image
    bins: Bins

    def offset(self, place: Point) -> Point:
        """Pixels of the patch (x, y) from its middle to ``place`` in the frame."""
        (x, y), (sx, sy) = self.patch.center, self.patch.step
        return (place[0] - x) / sx, (place[1] - y) / sy


@dataclass(frozen=True, slots=True)
class Observation:
    """The search window at one place of a cut, and what the models see in it.

    ``moved`` is where the window lies, whole pixels of the patch (x, y) from the middle. ``spectra`` and ``bins``
    are empty where there is no such model.
    """

    cut: Cut
    moved: tuple[int, int]
    spectra: Spectra
    bins: Bins

    def offset(self, place: Point) -> Point:
        """Cells (x, y) from the middle of the window to ``place`` in the frame."""
        x, y = self.cut.offset(place)
        return (x - self.moved[0]) / CELL, (y - self.moved[1]) / CELL

    def is_central(self, place: Point) -> bool:
        """Whether ``place`` is within a cell of the middle of the window."""
        return max(map(abs, self.offset(place))) <= 1

    def displaced(self, displacement: Point) -> Point:
        """The place in the frame that lies ``displacement`` (x, y) cells from the middle of the window."""
        (x, y), (sx, sy), (mx, my) = self.cut.patch.center, self.cut.patch.step, self.moved
        return x + (displacement[0] * CELL + mx) * sx, y + (displacement[1] * CELL + my) * sy


class Target:
    """The models of one target and where it is: what :meth:`MFCMT.init` builds.

    ``anchor`` is its centre in the last reliable frame; ``rival`` a place that peaked higher in the last frame.
    """

    def __init__(self, config: MFCMTConfig, base_size: Point, grey: bool) -> None:
        self.grey = grey
        self.base_size = base_size
        self.center: Point = (0.0, 0.0)
        self.anchor: Point = (0.0, 0.0)
        self.rival: Point | None = None
        self.scale = 1.0
        self.window = SearchWindow(config, base_size)
        cues = [c for c in config.features if not (grey and c == "color_names")]
        self.template = TemplateModel(config, self.window, grey) if cues else None
        self.color = ColorModel(config, self.window, grey) if config.color_histogram or not cues else None
        self.sizes = ScaleModel(config, base_size) if config.num_scales > 1 else None
        self.reliability = Reliability(config)
        self.learn_within = config.learn_within
        self.largest_step = config.scale_step * (1 + 1e-6)  # rounding
        names = (self.template.names if self.template else ()) + (("statistical",) if self.color else ())
        self.map_names: tuple[str, ...] = names
        self.map_weights = np.ones(len(names), np.float32)
        if self.color:
            self.map_weights[-1] = config.statistical_weight if cues else 1

    def observe(self, frame: Frame, within: Rect, place: Point, cut: Cut | None = None) -> Observation:
        """Lines 2–4 of Algorithm 1: the window around ``place``, from ``cut`` where that shows it well or anew."""
        margin = self.window.margin
        if cut is None or not self._shows(cut, place):
            cut = self._cut(frame, within, place)
        x, y = (min(max(round(pixels), -margin), margin) for pixels in cut.offset(place))
        size = self.window.patch_size
        part = (slice(y + margin, y + margin + size), slice(x + margin, x + margin + size))
        pixels = np.ascontiguousarray(cut.pixels[part])
        gray = pixels if self.grey else np.ascontiguousarray(cut.gray[part])
        return Observation(
            cut,
            (x, y),
            self.template.spectra(pixels, gray) if self.template else np.empty(0, np.complex64),
            np.ascontiguousarray(cut.bins[part]) if self.color else cut.bins,
        )

    def _cut(self, frame: Frame, within: Rect, place: Point) -> Cut:
        patch = self.window.crop(frame, within, place, self.scale)
        pixels = as_mode(patch.pixels, self.grey)
        gray = pixels if self.grey else as_mode(pixels, grey=True)
        return Cut(patch, self.scale, pixels, gray, self.color.bins(pixels) if self.color else np.empty(0, np.uint16))

    def _shows(self, cut: Cut, place: Point) -> bool:
        """Whether the window around ``place`` may be taken from ``cut``; without a margin only if it is the cut."""
        if not self.learn_within:
            return self.window.rect(place, self.scale) == cut.patch.rect
        return self._is_alike(cut.scale) and max(map(abs, cut.offset(place))) <= self.window.margin

    def is_near(self, seen: Observation) -> bool:
        """Whether the models may learn from ``seen``, which was cut where the target was looked for."""
        if not self.learn_within:
            return self._shows(seen.cut, self.center)
        return self._is_alike(seen.cut.scale) and max(map(abs, seen.offset(self.center))) <= self.learn_within

    def would_see_again(self, seen: Observation, cut: Cut) -> bool:
        """Whether :meth:`observe` at the centre, from ``cut`` or anew, is sure to give ``seen``."""
        return self.is_near(seen) and (seen.cut is cut or seen.cut.scale == self.scale)

    def _is_alike(self, scale: float) -> bool:
        """Whether the present scale is at most one step from ``scale``."""
        return 1 / self.largest_step <= self.scale / scale <= self.largest_step

    def learn(self, seen: Observation, first: bool = False) -> None:
        """Line 11 of Algorithm 1, on an observation near the target."""
        offset = seen.offset(self.center) if self.learn_within else (0.0, 0.0)
        if self.template:
            self.template.learn(seen.spectra, offset, None if first else self.reliability.learned)
        if self.color:
            self.color.learn(seen.bins, offset, first)

    def maps(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Scratch for the single maps (maps, rows, columns) and the fused one (rows, columns)."""
        shape = (2 * self.window.reach[1] + 1, 2 * self.window.reach[0] + 1)
        return scratch("responses", (len(self.map_names), *shape)), scratch("fused", shape)

    @property
    def box(self) -> Box:
        """The box at the present centre and scale."""
        w, h = self.base_size[0] * self.scale, self.base_size[1] * self.scale
        return self.center[0] - w / 2, self.center[1] - h / 2, w, h


def is_grey(pixels: Image) -> bool:
    """Whether the channels differ by no more than rounding."""
    if pixels.ndim == 2:
        return True
    blue, green, red = cv2.split(pixels)
    worst = max(int(cv2.absdiff(blue, green).max()), int(cv2.absdiff(green, red).max()))
    return worst <= GREY_TOLERANCE


def as_mode(pixels: Image, grey: bool) -> Image:
    """The pixels in the channels that the target's models expect."""
    if grey == (pixels.ndim == 2):
        return pixels
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY if grey else cv2.COLOR_GRAY2BGR)  # type: ignore[return-value]
