"""One session as its lane holds it: its trackers, and its newest frame in encoded form."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

from mfcmt_core import MFCMT, BadBox, MFCMTConfig, RegionTooSmall, TrackResult
from mfcmt_core.images import FrameError, inspect
from mfcmt_core.images.decode import Image, decode, decode_inspected, decode_part

from ..protocol.enums import Preset, ProblemCode, Resize
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from .contents import options_of
from .limits import LaneLimits
from .rows import Rect, covers, from_row, map_images, to_row, union

PRESETS: dict[str, Callable[[], MFCMTConfig]] = {
    Preset.DEFAULT: MFCMTConfig.default,
    Preset.PAPER: MFCMTConfig.paper,
}


@dataclass(frozen=True, slots=True)
class FrameView:
    """``image`` is the part of a frame of ``frame_size`` (w, h) whose top-left pixel is at ``offset`` (x, y)."""

    image: Image
    offset: tuple[int, int]
    frame_size: tuple[int, int]

    def start(self, tracker: MFCMT, box: Iterable[float]) -> TrackResult:
        """Start ``tracker`` here, or correct it. Raises bad-box, full-frame-needed."""
        x, y, w, h = box
        try:
            return tracker.init(self.image, (x, y, w, h), offset=self.offset, frame_size=self.frame_size)
        except BadBox as bad:
            raise ProblemError(ProblemCode.BAD_BOX, bad.reason) from bad
        except RegionTooSmall as cut:
            whole = [0, 0, *self.frame_size]
            raise ProblemError(ProblemCode.FULL_FRAME_NEEDED, "send the whole frame", region=whole) from cut


@dataclass(slots=True)
class TrackedTarget:
    """A tracker and its latest result."""

    tracker: MFCMT
    result: TrackResult


class LaneSession:
    """Tracks all targets of a session. Every ProblemError leaves the session as it was."""

    def __init__(self, options: Options, limits: LaneLimits) -> None:
        self._options, self._limits = options, limits
        self._targets: dict[int, TrackedTarget] = {}
        self._next_id = 0
        self._seq = 0
        self._size = (0, 0)
        self._newest = b""
        self._newest_at = (0, 0)
        self._want_full = False

    def start(self, data: bytes, boxes: Iterable[Iterable[float]]) -> dict[str, Any]:
        """Start a target on every box of the first frame, or none of them, and return the state."""
        begun = perf_counter()
        view = self._view(data, None)
        decoded = perf_counter()
        self._size, self._newest = view.frame_size, data
        for box in boxes:
            self._add(view, box)
        return self._state(decoded - begun, perf_counter() - decoded)

    def track(self, seq: int, data: bytes, region: list[int] | None, controls: list[dict[str, Any]]) -> dict[str, Any]:
        """Track every target in the next frame, and return the state.

        ``controls`` act on this very frame, each by itself; the state's ``answers`` has for each None or its refusal
        as ``[code, detail, members]``.
        """
        begun = perf_counter()
        view = self._view(data, region, whole=bool(controls))
        decoded = perf_counter()
        started: set[int] = set()  # on this frame: they are not tracked in it
        if view.frame_size != self._size:
            self._targets = self._rescaled(view)
            started.update(self._targets)
        answers = [self._try_control(view, control, started) for control in controls]
        for target_id, target in self._targets.items():
            if target_id not in started:
                target.result = target.tracker.update(
                    view.image, offset=view.offset, frame_size=view.frame_size, maps=self._options.maps
                )
        if region is None:
            self._want_full = False
        self._seq, self._size = seq, view.frame_size
        self._newest, self._newest_at = data, (0, 0) if region is None else (region[0], region[1])
        return self._state(decoded - begun, perf_counter() - decoded) | {"answers": answers}

    def control(self, control: dict[str, Any]) -> dict[str, Any]:
        """Add, correct or remove a target on the newest frame, and return the state."""
        view = None
        if control["type"] != "remove":
            image, _ = decode(self._newest, self._limits.frame)
            view = FrameView(image, self._newest_at, self._size)
        target_id = self._control(view, control, set())
        return self._state(0.0, 0.0) | {"target": target_id}

    def to_dict(self) -> dict[str, Any]:
        """Return the whole session as plain values."""
        return {
            "options": asdict(self._options),
            "targets": [
                (to_row(tid, target.result), target.tracker.to_bytes()) for tid, target in self._targets.items()
            ],
            "next_id": self._next_id,
            "seq": self._seq,
            "size": self._size,
            "newest": self._newest,
            "newest_at": self._newest_at,
            "want_full": self._want_full,
        }

    @classmethod
    def from_dict(cls, contents: dict[str, Any], limits: LaneLimits) -> LaneSession:
        """Return the session that :meth:`to_dict` wrote. Raises BadSnapshot, TypeError, KeyError for others."""
        session = cls(options_of(contents), limits)
        for row, tracker in contents["targets"]:
            session._targets[row[0]] = TrackedTarget(MFCMT.from_bytes(tracker), from_row(row))
        session._next_id, session._seq = contents["next_id"], contents["seq"]
        session._newest, session._want_full = contents["newest"], contents["want_full"]
        (width, height), (x, y) = contents["size"], contents["newest_at"]
        session._size, session._newest_at = (width, height), (x, y)
        return session

    def state(self) -> dict[str, Any]:
        """Return what the front knows of the session."""
        return self._state(0.0, 0.0)

    def _try_control(self, view: FrameView, control: dict[str, Any], started: set[int]) -> list[Any] | None:
        try:
            self._control(view, control, started)
        except ProblemError as refused:
            return [refused.code, refused.detail, refused.members]
        return None

    def _control(self, view: FrameView | None, control: dict[str, Any], started: set[int]) -> int:
        kind = control["type"]
        target_id: int = self._next_id if kind == "add" else control["target"]
        if kind != "add" and target_id not in self._targets:
            raise ProblemError(ProblemCode.TARGET_NOT_FOUND, f"no target {target_id}")
        try:
            if view is None or kind == "remove":
                del self._targets[target_id]
            elif kind == "add":
                self._add(view, control["box"])
            else:
                target = self._targets[target_id]
                target.result = view.start(target.tracker, control["box"])
        except ProblemError as refused:
            self._want_full |= refused.code == ProblemCode.FULL_FRAME_NEEDED
            raise
        started.add(target_id)
        return target_id

    def _add(self, view: FrameView, box: Iterable[float]) -> None:
        most = self._limits.max_targets
        if len(self._targets) >= most:
            raise ProblemError(ProblemCode.TOO_MANY_TARGETS, f"at most {most} targets")
        self._targets[self._next_id] = self._started(view, box)
        self._next_id += 1

    def _started(self, view: FrameView, box: Iterable[float]) -> TrackedTarget:
        tracker = MFCMT(PRESETS[self._options.preset]())
        return TrackedTarget(tracker, view.start(tracker, box))

    def _view(self, data: bytes, region: list[int] | None, *, whole: bool = False) -> FrameView:
        """Return the frame's pixels: all that were sent, if ``whole``, or the part that the trackers look at.

        Raises ProblemError if its header, its region or its data are no good.
        """
        try:
            info = inspect(data, self._limits.frame)
            size = (info.width, info.height)
            if self._size != (0, 0):
                self._check_region(size, region)
            x, y = (0, 0) if region is None else region[:2]
            frame_size = size if region is None else self._size
            needed = None if whole or frame_size != self._size else self._needed()
            if needed is None:
                return FrameView(decode_inspected(data, info), (x, y), frame_size)
            image, (left, top) = decode_part(data, info, (needed[0] - x, needed[1] - y, needed[2], needed[3]))
        except FrameError as bad:
            raise ProblemError(ProblemCode(bad.code), bad.detail) from bad
        return FrameView(image, (x + left, y + top), frame_size)

    def _needed(self) -> Rect | None:
        """Return the part of the next frame that the trackers look at, None without targets."""
        return union(target.tracker.needed_region() for target in self._targets.values())

    def _check_region(self, size: tuple[int, int], region: list[int] | None) -> None:
        """Check that an image of ``size`` is the whole frame, or a region that covers what the trackers need."""
        if region is None:
            if size != self._size and self._options.on_resize == Resize.REJECT:
                detail = "{}x{} expected, {}x{} sent".format(*self._size, *size)
                raise ProblemError(ProblemCode.FRAME_SIZE_CHANGED, detail)
            return
        x, y, w, h = region
        needed = self._needed()
        fault = None
        if (w, h) != size:
            fault = "the image is {}x{}, which is not the region's size".format(*size)
        elif x < 0 or y < 0 or x + w > self._size[0] or y + h > self._size[1]:
            fault = "the region leaves the frame"
        elif needed is not None and not covers((x, y, w, h), needed):
            fault = "the region does not cover what is needed"
        if fault:
            raise ProblemError(ProblemCode.BAD_REGION, fault, region=needed)

    def _rescaled(self, view: FrameView) -> dict[int, TrackedTarget]:
        """Return all targets started anew on a frame of another size, their boxes scaled with it."""
        across, down = view.frame_size[0] / self._size[0], view.frame_size[1] / self._size[1]
        started = {}
        for target_id, target in self._targets.items():
            x, y, w, h = target.result.box
            w, h = w * across, h * down
            # A target that has left the frame waits for its return at the border.
            x = min(max(x * across, 0.0), max(view.frame_size[0] - w, 0.0))
            y = min(max(y * down, 0.0), max(view.frame_size[1] - h, 0.0))
            try:
                started[target_id] = self._started(view, (x, y, w, h))
            except ProblemError as refused:
                detail = f"target {target_id} cannot be carried over"
                raise ProblemError(ProblemCode.FRAME_SIZE_CHANGED, detail) from refused
        return started

    def _region(self) -> Rect | None:
        if self._targets and self._want_full:
            return (0, 0, *self._size)
        return union(target.tracker.region(self._limits.region_lag) for target in self._targets.values())

    def _state(self, decode_s: float, track_s: float) -> dict[str, Any]:
        state = {
            "seq": self._seq,
            "size": self._size,
            "region": self._region(),
            "rows": [to_row(target_id, target.result) for target_id, target in self._targets.items()],
            "decode_s": decode_s,
            "track_s": track_s,
        }
        if self._options.maps:
            state["maps"] = [map_images(target.result.maps) for target in self._targets.values()]
        return state
