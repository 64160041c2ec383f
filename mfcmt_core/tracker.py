"""The tracker: Algorithm 1 of the paper, one frame after another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from . import snapshot
from .config import MFCMTConfig
from .errors import BadConfig, BadImage, BadSnapshot, NotInitialised
from .geometry import Frame, Image, Rect, SearchWindow, check_box, clip_rect, grow_rect
from .reliability import Verdict
from .result import TrackResult
from .search import Candidate, Search, copy_maps
from .target import Target, is_gray

REGION_FACTOR = 1.25
"""Size of the region that is read from each frame, as a multiple of the search window.

The target may move by an eighth of the window and still be learned with all of its surroundings. Where it moves
further, the border pixels of the region are repeated."""
WIDE_REGION_FACTOR = 2.0
"""The same after a frame with a low template peak: this region holds the neighboring windows on all four sides."""
SURE = 0.75
"""Confidence from which on a learned frame shows what the target looks like now, for the search of whole frames."""
MOTION_MARGIN = 0.5
"""Margin that :meth:`MFCMT.region` adds on each side per frame in flight, as a fraction of the target's side."""


class MFCMT:
    """Track one target through a sequence of frames.

    An instance must not be used by two threads at once. A call that raises leaves the tracker unchanged.

    Parameters
    ----------
    config : MFCMTConfig, optional
        The parameters; :meth:`MFCMTConfig.default` if omitted.

    References
    ----------
    P. Gao, Y. Ma, C. Li, K. Song, F. Wang and L. Xiao, "A Complementary Tracking Model with Multiple Features", 2018,
    arXiv:1804.07459. Equations, sections and Algorithm 1 that the code names are those of this paper.

    Examples
    --------
    >>> from mfcmt_core import MFCMT, synthetic
    >>> clip = synthetic.clip("motion", length=3)
    >>> tracker = MFCMT()
    >>> first = tracker.init(clip.frames[0], clip.boxes[0])
    >>> [tracker.update(frame).status for frame in clip.frames[1:]]
    ['tracking', 'tracking']
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
        """Start to track the target in ``box``. To correct a running tracker, call this again.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W, 3) or (H, W)
            The first frame, BGR or gray, with any strides; or a region of it (see ``offset``).
        box : iterable of four floats
            The target's ``(x, y, w, h)`` in pixels of the whole frame, 0-based. Each side is one pixel at least, and
            a quarter of the box lies in the frame.
        offset : (int, int), optional
            Position (x, y) in the frame of the first pixel of ``image``, if that is a region of the frame.
        frame_size : (int, int), optional
            Size (w, h) of the whole frame; by default that of ``image``.

        Returns
        -------
        TrackResult
            The given box with confidence 1 and no flags, scores or ``psr``. If the window around the box is flat, there
            is nothing to follow: the confidence is low and the status ``"uncertain"``.

        Raises
        ------
        BadImage
            If the image has another dtype or shape, or does not lie in the frame.
        BadBox
            If the box is not four finite numbers, is too small, or lies mostly outside the frame.
        RegionTooSmall
            If the image does not show all that the tracker reads; the exception says what that is.
        """
        frame = Frame.of(image, offset, frame_size)
        x, y, w, h = check_box(box, frame.size)
        center = (min(max(x + w / 2, 0.0), frame.size[0]), min(max(y + h / 2, 0.0), frame.size[1]))
        window = SearchWindow(self.config, (w, h))
        readable = clip_rect(window.rect(center, 1.0, REGION_FACTOR), frame.size)
        frame.require(readable)
        target = Target(self.config, (w, h), is_gray(window.crop(frame, readable, center, 1.0).pixels))
        target.center = target.last_reliable_center = center
        observation = target.observe(frame, readable, center)
        target.learn(observation, first=True)
        if model := target.scale_model:
            model.learn(model.spectra(frame, readable, center, 1.0), first=True)
        pixels = target.box_pixels(observation.crop, center, frame.size)
        confidence = target.confidence.start(pixels)
        target.looks.remember(pixels)
        self._target, self._frame_size = target, frame.size
        return TrackResult(
            box=(x, y, w, h),
            status=target.reliability.start(confidence),
            confidence=confidence,
            reliable=None,
            flags=None,
            scores=None,
            psr=None,
            updated=True,
            scale=1.0,
        )

    def update(
        self,
        image: Image,
        *,
        offset: tuple[int, int] = (0, 0),
        frame_size: tuple[int, int] | None = None,
        maps: bool = False,
    ) -> TrackResult:
        """Find the target in the next frame, and learn from the frame if it is reliable.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W, 3) or (H, W)
            The next frame, or a region of it that covers :meth:`needed_region`.
        offset : (int, int), optional
            Position (x, y) in the frame of the first pixel of ``image``.
        frame_size : (int, int), optional
            Size (w, h) of the whole frame; by default that of ``image``. It must be that of the first frame.
        maps : bool, optional
            Return copies of the response maps in :attr:`TrackResult.maps`. This takes about half an update more.

        Returns
        -------
        TrackResult
            The target's box in the whole frame and how far to trust it.

        Raises
        ------
        NotInitialised
            If :meth:`init` was not called.
        BadImage
            If the image has another dtype or shape, does not lie in the frame, or the frame has another size.
        RegionTooSmall
            If the image does not cover :meth:`needed_region`.
        """
        target = self._require_target()
        frame = Frame.of(image, offset, frame_size)
        if frame.size != self._frame_size:
            raise BadImage(f"the frame is {frame.size}, the first one was {self._frame_size}")
        readable = self.needed_region()
        frame.require(readable)

        candidate = self._search(target, frame, readable)
        map_copies = copy_maps(self.config, target, frame, candidate.observation) if maps else None
        detection = candidate.detection
        is_jump, last_scale = candidate.jump_scale is not None, target.scale
        target.scale = candidate.jump_scale or last_scale
        pixels = target.box_pixels(candidate.observation.crop, detection.center, frame.size)
        is_new = is_jump or target.reliability.lost
        confidence, is_flat = target.confidence.judge(detection.evidence, pixels, is_new)
        verdict = target.reliability.judge(candidate.peaks, confidence, is_jump)
        if verdict.status == "lost":
            target.center, target.scale = target.last_reliable_center, last_scale  # what peaked since then was noise
        elif not (is_flat and self.config.tracking_threshold):  # a flat map has its peak anywhere
            target.center = detection.center
            self._update_scale(target, frame, readable, verdict)
        if verdict.learnable:
            target.last_reliable_center = target.center
            self._learn(target, frame, readable, candidate)
            if confidence >= SURE:
                target.looks.remember(pixels)
        return TrackResult(
            box=target.box,
            status=verdict.status,
            confidence=verdict.confidence,
            reliable=verdict.reliable,
            flags=verdict.flags,
            scores=verdict.scores,
            psr=detection.evidence.psr,
            updated=verdict.learnable,
            scale=target.scale,
            maps=map_copies,
        )

    def track(self, frames: Iterable[Image], box: Iterable[float]) -> Iterator[TrackResult]:
        """Track the target in ``box`` through ``frames``.

        Parameters
        ----------
        frames : iterable of ndarray
            Whole frames as :meth:`update` takes them. A frame is read when its result is asked for.
        box : iterable of four floats
            The target in the first frame, as :meth:`init` takes it.

        Yields
        ------
        TrackResult
            One result per frame, the first included.

        Raises
        ------
        BadImage, BadBox
            As :meth:`init` and :meth:`update` do.
        """
        for index, image in enumerate(frames):
            yield self.update(image) if index else self.init(image, box)

    def needed_region(self) -> Rect:
        """Return the part of the next frame that decides the result. Pixels outside it change no bit of it.

        Returns
        -------
        (int, int, int, int)
            ``(x, y, w, h)`` in pixels of the frame; the whole frame while that is searched for the target.

        Raises
        ------
        NotInitialised
            If :meth:`init` was not called.
        """
        target = self._require_target()
        if target.reliability.searching:
            return (0, 0, *self._frame_size)
        factor = WIDE_REGION_FACTOR if target.reliability.template_low else REGION_FACTOR
        return clip_rect(target.search_window.rect(target.center, target.scale, factor), self._frame_size)

    def region(self, lag: int = 1) -> Rect:
        """Return :meth:`needed_region` with a margin for the motion of frames whose results are not known yet.

        Parameters
        ----------
        lag : int, optional
            Number of frames in flight. Each adds half of the target's side on each side of the region.

        Returns
        -------
        (int, int, int, int)
            ``(x, y, w, h)`` in pixels of the frame.

        Raises
        ------
        NotInitialised
            If :meth:`init` was not called.
        """
        needed = self.needed_region()
        _, _, w, h = self._require_target().box
        return clip_rect(grow_rect(needed, lag * MOTION_MARGIN * w, lag * MOTION_MARGIN * h), self._frame_size)

    def to_bytes(self) -> bytes:
        """Return the whole state as a snapshot, which :meth:`from_bytes` reads.

        Returns
        -------
        bytes
            A versioned MessagePack document with raw little-endian arrays; well below 1 MB with the default preset.

        Raises
        ------
        NotInitialised
            If :meth:`init` was not called.
        """
        return snapshot.dump(self.config, self._require_target(), self._frame_size)

    @classmethod
    def from_bytes(cls, data: bytes) -> MFCMT:
        """Return the tracker that a snapshot holds. All its later results are equal to the last bit.

        Parameters
        ----------
        data : bytes
            What :meth:`to_bytes` returned, of this version of the format or the one before.

        Returns
        -------
        MFCMT
            A new tracker with the snapshot's configuration.

        Raises
        ------
        BadSnapshot
            If the bytes are no snapshot, are of another version, or hold values that no tracker has.
        """
        config, state, frame_size = snapshot.parse(data)
        tracker = cls(config)
        try:
            target = Target(config, state.base_size, state.is_gray)
        except BadConfig as error:  # the color-name table is a file that may be missing here
            raise BadSnapshot(str(error)) from error
        snapshot.restore(target, state)
        tracker._target, tracker._frame_size = target, frame_size
        return tracker

    def _require_target(self) -> Target:
        if self._target is None:
            raise NotInitialised("call init first")
        return self._target

    def _search(self, target: Target, frame: Frame, readable: Rect) -> Candidate:
        return Search(self.config, target, frame, readable).run()

    def _update_scale(self, target: Target, frame: Frame, readable: Rect, verdict: Verdict) -> None:
        """Find the target's scale, and learn it if the frame is reliable (lines 8 and 10 of Algorithm 1)."""
        model = target.scale_model
        if model is None or not (verdict.learnable or not self.config.scale_when_reliable):
            return
        if verdict.learnable and not model.advance(busy=target.reliability.template_low):
            return
        spectra = model.spectra(frame, readable, target.center, target.scale)
        scale = model.clamp(target.scale * model.estimate(spectra), frame.size)
        if verdict.learnable:
            growth = scale / target.scale
            if growth != 1 and not self.config.learn_within:
                spectra, growth = model.spectra(frame, readable, target.center, scale), 1.0
            model.learn(spectra, growth)
        target.scale = scale

    def _learn(self, target: Target, frame: Frame, readable: Rect, candidate: Candidate) -> None:
        """Learn template and colors at the target's center, from a window that was observed already if one fits."""
        observation = candidate.observation
        if not target.can_learn_from(observation):
            recentered = candidate.recentered
            if recentered is None or not target.can_reuse(recentered, observation.crop):
                recentered = target.observe(frame, readable, target.center, observation.crop)
            observation = recentered
        target.learn(observation)
        target.reliability.record_learned(candidate.peaks)
