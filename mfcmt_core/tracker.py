"""MFCMT: Algorithm 1 of the paper."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from . import snapshot
from .color import ColorModel
from .config import MFCMTConfig
from .errors import BadImage, NotInitialised
from .fusion import Peak, fuse
from .geometry import Frame, Image, Patch, Rect, SearchWindow, check_box, clip_rect, grow_rect
from .redetection import propose
from .reliability import Peaks, Reliability, Verdict
from .result import Box, TrackResult
from .scale import ScaleModel
from .template import TemplateModel
from .workspace import scratch

ATTENTION = 1.5
"""What a frame is looked at for: the search window times this. It leaves the target room to move by a quarter
of the window and still be learned with all of its surroundings; further out the border repeats."""
MOTION_ROOM = 0.5
"""Of the target's side, on each side of the region: how far it may move in one frame in flight."""
GREY_TOLERANCE = 1
"""Grey levels that the channels of a grey sequence may differ by."""

Point = tuple[float, float]


class Target:
    """The models of one target and where it is: what :meth:`MFCMT.init` builds."""

    def __init__(self, config: MFCMTConfig, base_size: Point, grey: bool) -> None:
        self.grey = grey
        self.base_size = base_size
        self.center: Point = (0.0, 0.0)
        self.scale = 1.0
        self.window = SearchWindow(config, base_size)
        cues = [c for c in config.features if not (grey and c == "color_names")]
        self.template = TemplateModel(config, self.window, grey) if cues else None
        self.color = ColorModel(config, self.window, grey) if config.color_histogram or not cues else None
        self.sizes = ScaleModel(config, base_size) if config.num_scales > 1 else None
        self.reliability = Reliability(config)
        names = (self.template.names if self.template else ()) + (("statistical",) if self.color else ())
        self.map_names: tuple[str, ...] = names
        self.map_weights = np.ones(len(names), np.float32)
        if self.color:
            self.map_weights[-1] = config.statistical_weight if cues else 1

    @property
    def box(self) -> Box:
        """The box at the present centre and scale."""
        w, h = self.base_size[0] * self.scale, self.base_size[1] * self.scale
        return self.center[0] - w / 2, self.center[1] - h / 2, w, h


class MFCMT:
    """Single-target tracker.

    Images are ``uint8``, BGR (H, W, 3) or grey (H, W), of any strides; boxes ``(x, y, w, h)``, floats,
    0-based. A call that raises has changed nothing. Not for use by two threads at once.

    >>> tracker = MFCMT()
    >>> tracker.init(first_frame, (10, 20, 30, 40))  # doctest: +SKIP
    >>> tracker.update(next_frame).box  # doctest: +SKIP
    """

    def __init__(self, config: MFCMTConfig | None = None) -> None:
        self.config = config or MFCMTConfig.default()
        self._target: Target | None = None
        self._frame_size = (0, 0)

    def init(
        self,
        image: Image,
        box: Iterable[float],
        *,
        offset: tuple[int, int] = (0, 0),
        frame_size: tuple[int, int] | None = None,
    ) -> TrackResult:
        """Start on ``box``, or start again on it: to correct a running tracker, call this.

        ``image`` may be a cut of the frame: ``offset`` is the frame's (x, y) of its first pixel and
        ``frame_size`` the whole frame's (w, h); the box counts in the whole frame all the same.
        Raises BadImage, BadBox, RegionTooSmall.
        """
        frame = Frame.of(image, offset, frame_size)
        x, y, w, h = check_box(box, frame.size)
        center = (min(max(x + w / 2, 0.0), frame.size[0]), min(max(y + h / 2, 0.0), frame.size[1]))
        window = SearchWindow(self.config, (w, h))
        within = clip_rect(window.rect(center, 1.0, ATTENTION), frame.size)
        frame.require(within)
        patch = window.crop(frame, within, center, 1.0)
        target = Target(self.config, (w, h), _is_grey(patch.pixels))
        target.center = center
        self._learn(target, frame, within, first=True)
        self._target, self._frame_size = target, frame.size
        return TrackResult((x, y, w, h), "tracking", None, None, None, None, True, 1.0)

    def update(
        self,
        image: Image,
        *,
        offset: tuple[int, int] = (0, 0),
        frame_size: tuple[int, int] | None = None,
        maps: bool = False,
    ) -> TrackResult:
        """Find the target in the next frame; ``image`` may be a cut that covers :meth:`needed_region`.

        Raises NotInitialised, BadImage (also for another frame size than the first), RegionTooSmall.
        """
        target = self._require_target()
        frame = Frame.of(image, offset, frame_size)
        if frame.size != self._frame_size:
            raise BadImage(f"the frame is {frame.size}, the first one was {self._frame_size}")
        within = self.needed_region()
        frame.require(within)

        center, peak, peaks, fused = self._search(target, frame, within)
        kept = self._copy_maps(target, fused) if maps else None
        verdict = target.reliability.judge(peaks)
        if verdict.status != "lost":
            target.center = center
        if target.sizes and (verdict.reliable or not self.config.scale_when_reliable) and verdict.status != "lost":
            factor = target.sizes.estimate(frame, within, target.center, target.scale)
            target.scale = target.sizes.clamp(target.scale * factor, frame.size)
        if verdict.reliable:
            self._learn(target, frame, within)
            target.reliability.learned_from(peaks)
        return _result(target, verdict, peak, kept)

    def track(self, frames: Iterable[Image], box: Iterable[float]) -> Iterator[TrackResult]:
        """Start on the first of ``frames`` and yield one result a frame, the first included."""
        for index, image in enumerate(frames):
            yield self.update(image) if index else self.init(image, box)

    def needed_region(self) -> Rect:
        """The part of the next frame that decides the result, (x, y, w, h): pixels outside it change no bit."""
        target = self._require_target()
        if target.reliability.lost:
            return (0, 0, *self._frame_size)
        return clip_rect(target.window.rect(target.center, target.scale, ATTENTION), self._frame_size)

    def region(self, lag: int = 1) -> Rect:
        """:meth:`needed_region` with room for the target to move during ``lag`` frames in flight."""
        needed = self.needed_region()
        _, _, w, h = self._require_target().box
        return clip_rect(grow_rect(needed, lag * MOTION_ROOM * w, lag * MOTION_ROOM * h), self._frame_size)

    def to_bytes(self) -> bytes:
        """The whole state, versioned: MessagePack with raw little-endian arrays. Raises NotInitialised."""
        return snapshot.dump(self.config, self._require_target(), self._frame_size)

    @classmethod
    def from_bytes(cls, data: bytes) -> MFCMT:
        """The tracker that :meth:`to_bytes` wrote; its every later result is bit-equal. Raises BadSnapshot."""
        config, state, frame_size = snapshot.parse(data)
        tracker = cls(config)
        target = Target(config, state.base_size, state.grey)
        snapshot.restore(target, state)
        tracker._target, tracker._frame_size = target, frame_size
        return tracker

    def _require_target(self) -> Target:
        if self._target is None:
            raise NotInitialised("call init first")
        return self._target

    def _search(self, target: Target, frame: Frame, within: Rect) -> tuple[Point, Peak, Peaks, npt.NDArray[np.float32]]:
        """Where the fused map peaks: around the last place and, while lost, also where colours propose."""
        found = self._detect(target, frame, within, target.center)
        if target.reliability.lost and target.color:
            proposal = propose(target.color, frame, target.base_size, target.scale)
            there = self._detect(target, frame, within, proposal)
            if there[2].template > found[2].template:
                return there
            found = self._detect(target, frame, within, target.center)  # the maps are scratch
        return found

    def _detect(
        self, target: Target, frame: Frame, within: Rect, center: Point
    ) -> tuple[Point, Peak, Peaks, npt.NDArray[np.float32]]:
        """Lines 2–7 of Algorithm 1: crop, respond, fuse, take the peak."""
        window = target.window
        patch = _as_mode(window.crop(frame, within, center, target.scale), target.grey)
        shape = (2 * window.reach[1] + 1, 2 * window.reach[0] + 1)
        responses = scratch("responses", (len(target.map_names), *shape))
        fused = scratch("fused", shape)
        template = (
            target.template.respond(patch.pixels, responses[: len(target.template.names)]) if target.template else 1.0
        )
        statistical = target.color.respond(patch.pixels, responses[-1]) if target.color else 1.0
        peak = fuse(responses, target.map_weights, self.config, fused)
        x, y = window.displaced(patch, peak.displacement)
        width, height = frame.size
        place = (min(max(x, 0.0), float(width)), min(max(y, 0.0), float(height)))
        return place, peak, Peaks(peak.height, template, statistical), fused

    def _learn(self, target: Target, frame: Frame, within: Rect, first: bool = False) -> None:
        """Lines 10 and 11 of Algorithm 1, on the target where it now is."""
        patch = _as_mode(target.window.crop(frame, within, target.center, target.scale), target.grey)
        if target.template:
            target.template.learn(patch.pixels, first)
        if target.color:
            target.color.learn(patch.pixels, first)
        if target.sizes:
            target.sizes.learn(frame, within, target.center, target.scale, first)

    def _copy_maps(self, target: Target, fused: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
        """The probability maps of the last search by name."""
        responses = scratch("responses", (len(target.map_names), *fused.shape))
        return {"fused": fused.copy()} | {
            name: np.array(r) for name, r in zip(target.map_names, responses, strict=True)
        }


def _result(target: Target, verdict: Verdict, peak: Peak, maps: Any) -> TrackResult:
    return TrackResult(
        target.box,
        verdict.status,
        verdict.reliable,
        verdict.flags,
        verdict.scores,
        peak.psr,
        verdict.reliable,
        target.scale,
        maps,
    )


def _is_grey(pixels: Image) -> bool:
    """Whether the channels differ by no more than rounding."""
    if pixels.ndim == 2:
        return True
    blue, green, red = cv2.split(pixels)
    worst = max(int(cv2.absdiff(blue, green).max()), int(cv2.absdiff(green, red).max()))
    return worst <= GREY_TOLERANCE


def _as_mode(patch: Patch, grey: bool) -> Patch:
    """The patch in the channels that its target's models expect."""
    if grey == (patch.pixels.ndim == 2):
        return patch
    code = cv2.COLOR_BGR2GRAY if grey else cv2.COLOR_GRAY2BGR
    return Patch(cv2.cvtColor(patch.pixels, code), patch.center, patch.step)  # type: ignore[arg-type]
