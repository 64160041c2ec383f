"""MFCMT: Algorithm 1 of the paper."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter

import numpy as np
import numpy.typing as npt

from . import snapshot
from .config import MFCMTConfig
from .errors import BadConfig, BadImage, BadSnapshot, NotInitialised
from .fusion import fuse
from .geometry import Frame, Image, Rect, SearchWindow, check_box, clip_rect, grow_rect
from .redetection import other_peak, propose
from .reliability import Peaks, Verdict
from .result import TrackResult
from .target import Cut, Observation, Point, Target, is_grey

ATTENTION = 1.25
"""What a frame is looked at for: the search window times this. It leaves the target room to move by an eighth
of the window and still be learned with all of its surroundings; further out the border repeats."""
WIDE_ATTENTION = 2.0
"""The same where the last frame left doubts: the windows on all four sides, too."""
MOTION_ROOM = 0.5
"""Of the target's side, on each side of the region: how far it may move in one frame in flight."""


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search ended: centre in the frame, the peaks of its maps, peak-to-sidelobe ratio."""

    center: Point
    peaks: Peaks
    psr: float


@dataclass(frozen=True, slots=True)
class Look:
    """What the window around one place showed and where its maps peak; ``closer`` is the window there, if seen."""

    seen: Observation
    found: Found
    closer: Observation | None = None

    @property
    def strength(self) -> tuple[float, float]:
        return self.found.peaks.strength


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
        grey = is_grey(window.crop(frame, within, center, 1.0).pixels)
        target = Target(self.config, (w, h), grey)
        target.center = target.anchor = center
        target.learn(target.observe(frame, within, center), first=True)
        if target.sizes:
            target.sizes.learn(target.sizes.spectra(frame, within, center, 1.0), first=True)
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

        look = self._search(target, frame, within)
        seen, found = look.seen, look.found
        kept = self._copy_maps(target, frame, seen) if maps else None
        verdict = target.reliability.judge(found.peaks)
        if verdict.status == "lost":
            target.center = target.anchor  # since then there were only noise peaks to follow
        else:
            target.center = found.center
            self._resize(target, frame, within, verdict)
        if verdict.reliable:
            target.anchor = target.center
            if not target.is_near(seen):
                closer = look.closer
                if closer is None or not target.would_see_again(closer, seen.cut):
                    closer = target.observe(frame, within, target.center, seen.cut)
                seen = closer
            target.learn(seen)
            target.reliability.learned_from(found.peaks)
        return TrackResult(
            box=target.box,
            status=verdict.status,
            reliable=verdict.reliable,
            flags=verdict.flags,
            scores=verdict.scores,
            psr=found.psr,
            updated=verdict.reliable,
            scale=target.scale,
            maps=kept,
        )

    def track(self, frames: Iterable[Image], box: Iterable[float]) -> Iterator[TrackResult]:
        """Start on the first of ``frames`` and yield one result a frame, the first included."""
        for index, image in enumerate(frames):
            yield self.update(image) if index else self.init(image, box)

    def needed_region(self) -> Rect:
        """The part of the next frame that decides the result, (x, y, w, h): pixels outside it change no bit."""
        target = self._require_target()
        if target.reliability.lost:
            return (0, 0, *self._frame_size)
        attention = WIDE_ATTENTION if target.reliability.doubtful else ATTENTION
        return clip_rect(target.window.rect(target.center, target.scale, attention), self._frame_size)

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
        try:
            target = Target(config, state.base_size, state.grey)
        except BadConfig as error:  # the colour-name table is a file
            raise BadSnapshot(str(error)) from error
        snapshot.restore(target, state)
        tracker._target, tracker._frame_size = target, frame_size
        return tracker

    def _require_target(self) -> Target:
        if self._target is None:
            raise NotInitialised("call init first")
        return self._target

    def _search(self, target: Target, frame: Frame, within: Rect) -> Look:
        """Where the fused map peaks: around the last place, and elsewhere while the target may not be there."""
        look = partial(self._look, target, frame, within)
        first = look(target.center)
        rival, target.rival = target.rival, None
        if target.reliability.lost:
            best = first
            if target.color:
                proposed = look(propose(target.color, frame, target.base_size, target.scale))
                best = max(first, proposed, key=attrgetter("strength"))
            return look(best.found.center)  # a second look from there: the surroundings at their place, too
        was_doubtful, target.reliability.doubtful = target.reliability.doubtful, False
        if not target.reliability.doubts(first.found.peaks):
            return first
        if not was_doubtful:
            peak = other_peak(target.maps()[1], target.window.target)
            rival = first.seen.displaced(peak) if peak else None
        elif rival is None:
            rival = self._aside(target)
        centred = first
        if not first.seen.is_central(first.found.center):  # off the middle of the window a target's peak is lower
            centred = look(first.found.center, first.seen.cut)
            first = replace(first, closer=centred.seen)
            if not target.reliability.doubts(centred.found.peaks):
                return first
        target.reliability.doubtful = True
        if rival is None or not frame.contains(rival):
            return first
        other = look(rival)
        if other.found.peaks.template > self.config.doubt_margin * centred.found.peaks.template:
            return other
        if other.strength > centred.strength:  # and higher still where it is central: in the next frame
            target.rival = other.found.center
        return first

    def _aside(self, target: Target) -> Point:
        """The place half a window aside: one side a frame, in turn, to keep each one short."""
        side = (target.reliability.learned + target.reliability.unreliable_run) % 4
        return target.window.neighbour(target.center, target.scale, side)

    def _look(self, target: Target, frame: Frame, within: Rect, place: Point, cut: Cut | None = None) -> Look:
        """What the window around ``place`` shows and where its fused map peaks."""
        seen = target.observe(frame, within, place, cut)
        return Look(seen, self._detect(target, frame, seen))

    def _detect(self, target: Target, frame: Frame, seen: Observation) -> Found:
        """Lines 5–7 of Algorithm 1: respond, fuse, take the peak."""
        responses, fused = target.maps()
        models = 0
        if target.template:
            models = len(target.template.blocks)
            target.template.respond(seen.spectra, responses[: len(target.template.names)])
        if target.color:
            target.color.respond(seen.bins, responses[-1])
        peak = fuse(responses, target.map_weights, self.config, fused)
        template = sum(peak.tops[:models]) / models if models else 1.0
        statistical = peak.tops[-1] if target.color else 1.0
        x, y = seen.displaced(peak.displacement)
        center = (min(max(x, 0.0), float(frame.size[0])), min(max(y, 0.0), float(frame.size[1])))
        return Found(center, Peaks(peak.height, template, statistical), peak.psr)

    def _resize(self, target: Target, frame: Frame, within: Rect, verdict: Verdict) -> None:
        """Lines 8 and 10 of Algorithm 1: find the scale, and learn it where the frame is reliable."""
        sizes = target.sizes
        if sizes is None or not (verdict.reliable or not self.config.scale_when_reliable):
            return
        if verdict.reliable and not sizes.takes_turn(busy=target.reliability.doubtful):
            return
        spectra = sizes.spectra(frame, within, target.center, target.scale)
        scale = sizes.clamp(target.scale * sizes.estimate(spectra), frame.size)
        if verdict.reliable:
            growth = scale / target.scale
            if growth != 1 and not self.config.learn_within:
                spectra, growth = sizes.spectra(frame, within, target.center, scale), 1.0
            sizes.learn(spectra, growth)
        target.scale = scale

    def _copy_maps(self, target: Target, frame: Frame, seen: Observation) -> dict[str, npt.NDArray[np.float32]]:
        """The probability maps by name, of a joint filter also the part of each cue.

        They are computed again, for the search may have looked elsewhere since.
        """
        self._detect(target, frame, seen)
        responses, fused = target.maps()
        kept = {"fused": fused.copy()}
        kept |= {name: np.array(r) for name, r in zip(target.map_names, responses, strict=True)}
        if target.template and self.config.joint_filter:
            parts = target.template.respond_by_cue(seen.spectra)
            for name, part in parts.items():
                fuse(part[None], np.ones(1, np.float32), self.config, np.empty_like(part))
                kept[name] = part
        return kept
