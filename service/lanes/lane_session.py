"""One session as its lane holds it: trackers, and the newest frame (encoded)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from mfcmt_core import MFCMT, MFCMTConfig, TrackResult
from mfcmt_core.images import FrameError, FrameLimits
from mfcmt_core.images.decode import decode

from .frame_view import FrameView, Refused
from .rows import Rect, covers, from_row, map_images, to_row, union

PRESETS: dict[str, Callable[[], MFCMTConfig]] = {"default": MFCMTConfig.default, "paper": MFCMTConfig.paper}


@dataclass(frozen=True, slots=True)
class Options:
    """What a client may choose for its trackers, and what holds for all sessions of a lane."""

    limits: FrameLimits
    max_targets: int
    region_lag: int
    preset: str
    on_resize: str
    maps: bool


@dataclass(slots=True)
class Target:
    """A tracker and what it said last."""

    tracker: MFCMT
    result: TrackResult


class LaneSession:
    """Every refusal leaves the session as it was."""

    def __init__(self, options: Options) -> None:
        self._options = options
        self._targets: dict[int, Target] = {}
        self._next_id = 0
        self._seq = 0
        self._size = (0, 0)
        self._newest = b""
        self._newest_at = (0, 0)
        self._want_full = False

    def begin(self, data: bytes, boxes: Iterable[Iterable[float]]) -> dict[str, Any]:
        """Start every box on the first frame, or none."""
        clock = perf_counter()
        view = self._view(data, None)
        decoded = perf_counter()
        self._size, self._newest = view.frame_size, data
        for box in boxes:
            self._add(view, box)
        return self._state(decoded - clock, perf_counter() - decoded)

    def track(self, seq: int, data: bytes, region: list[int] | None, controls: list[dict[str, Any]]) -> dict[str, Any]:
        """Every target in the next frame; ``controls`` act on this very frame, each for itself."""
        clock = perf_counter()
        view = self._view(data, region)
        decoded = perf_counter()
        fresh: set[int] = set()
        if view.frame_size != self._size:
            self._targets = self._rescaled(view)
            fresh.update(self._targets)
        answers = [self._attempt(view, control, fresh) for control in controls]
        for tid, target in self._targets.items():
            if tid not in fresh:
                target.result = view.update(target.tracker, self._options.maps)
        if region is None:
            self._want_full = False
        self._seq, self._size = seq, view.frame_size
        self._newest, self._newest_at = data, view.offset
        return self._state(decoded - clock, perf_counter() - decoded) | {"answers": answers}

    def control(self, control: dict[str, Any]) -> dict[str, Any]:
        """Add, correct or remove a target on the newest frame."""
        view = None
        if control["type"] != "remove":
            image, _ = decode(self._newest, self._options.limits)
            view = FrameView(image, self._newest_at, self._size)
        target = self._control(view, control, set())
        return self._state(0.0, 0.0) | {"target": target}

    def to_dict(self) -> dict[str, Any]:
        """All of it, as plain values."""
        options = self._options
        return {
            "options": {"preset": options.preset, "on_resize": options.on_resize, "maps": options.maps},
            "targets": [(to_row(tid, t.result), t.tracker.to_bytes()) for tid, t in self._targets.items()],
            "next_id": self._next_id,
            "seq": self._seq,
            "size": self._size,
            "newest": self._newest,
            "newest_at": self._newest_at,
            "want_full": self._want_full,
        }

    @classmethod
    def from_dict(cls, options: Options, contents: dict[str, Any]) -> LaneSession:
        """What :meth:`to_dict` wrote. Raises BadSnapshot and, for what does not fit, the usual errors."""
        session = cls(options)
        for row, tracker in contents["targets"]:
            session._targets[row[0]] = Target(MFCMT.from_bytes(tracker), from_row(row))
        session._next_id, session._seq = contents["next_id"], contents["seq"]
        session._newest, session._want_full = contents["newest"], contents["want_full"]
        (width, height), (x, y) = contents["size"], contents["newest_at"]
        session._size, session._newest_at = (width, height), (x, y)
        return session

    def state(self) -> dict[str, Any]:
        """What the front knows of the session."""
        return self._state(0.0, 0.0)

    def _attempt(self, view: FrameView, control: dict[str, Any], fresh: set[int]) -> list[Any] | None:
        try:
            self._control(view, control, fresh)
        except Refused as refused:
            return [refused.code, refused.detail, refused.members]
        return None

    def _control(self, view: FrameView | None, control: dict[str, Any], fresh: set[int]) -> int:
        kind = control["type"]
        tid: int = self._next_id if kind == "add" else control["target"]
        if kind != "add" and tid not in self._targets:
            raise Refused("target-not-found", f"no target {tid}")
        try:
            if view is None or kind == "remove":
                del self._targets[tid]
            elif kind == "add":
                self._add(view, control["box"])
            else:
                self._targets[tid].result = view.start(self._targets[tid].tracker, control["box"])
        except Refused as refused:
            self._want_full |= refused.code == "full-frame-needed"
            raise
        fresh.add(tid)
        return tid

    def _add(self, view: FrameView, box: Iterable[float]) -> None:
        if len(self._targets) >= self._options.max_targets:
            raise Refused("too-many-targets", f"at most {self._options.max_targets} targets")
        tracker = MFCMT(PRESETS[self._options.preset]())
        self._targets[self._next_id] = Target(tracker, view.start(tracker, box))
        self._next_id += 1

    def _view(self, data: bytes, region: list[int] | None) -> FrameView:
        """The frame's pixels, once its header, its pixels and its region are found to be good."""
        try:
            image, info = decode(data, self._options.limits)
        except FrameError as bad:
            raise Refused(bad.code, bad.detail) from bad
        size = (info.width, info.height)
        if self._size != (0, 0):
            self._check_place(size, region)
        return (
            FrameView(image, (0, 0), size) if region is None else FrameView(image, (region[0], region[1]), self._size)
        )

    def _check_place(self, size: tuple[int, int], region: list[int] | None) -> None:
        if region is None:
            if size != self._size and self._options.on_resize == "reject":
                told = "{}x{} expected, {}x{} sent".format(*self._size, *size)
                raise Refused("frame-size-changed", told)
            return
        x, y, w, h = region
        needed = union(target.tracker.needed_region() for target in self._targets.values())
        fault = None
        if (w, h) != size:
            fault = "the image is {}x{}, not of the region's size".format(*size)
        elif x < 0 or y < 0 or x + w > self._size[0] or y + h > self._size[1]:
            fault = "the region leaves the frame"
        elif needed is not None and not covers((x, y, w, h), needed):
            fault = "the region does not cover what is needed"
        if fault:
            raise Refused("bad-region", fault, region=needed)

    def _rescaled(self, view: FrameView) -> dict[int, Target]:
        """All targets started anew on a frame of another size, their boxes scaled with it."""
        across, down = view.frame_size[0] / self._size[0], view.frame_size[1] / self._size[1]
        started = {}
        for tid, target in self._targets.items():
            x, y, w, h = target.result.box
            w, h = w * across, h * down
            # A target that has left the frame waits for its return at the border.
            x = min(max(x * across, 0.0), max(view.frame_size[0] - w, 0.0))
            y = min(max(y * down, 0.0), max(view.frame_size[1] - h, 0.0))
            tracker = MFCMT(PRESETS[self._options.preset]())
            try:
                started[tid] = Target(tracker, view.start(tracker, (x, y, w, h)))
            except Refused as refused:
                raise Refused("frame-size-changed", f"target {tid} cannot be carried over") from refused
        return started

    def _region(self) -> Rect | None:
        if self._targets and self._want_full:
            return (0, 0, *self._size)
        return union(target.tracker.region(self._options.region_lag) for target in self._targets.values())

    def _state(self, decode_s: float, track_s: float) -> dict[str, Any]:
        state = {
            "seq": self._seq,
            "size": self._size,
            "region": self._region(),
            "rows": [to_row(tid, target.result) for tid, target in self._targets.items()],
            "decode_s": decode_s,
            "track_s": track_s,
        }
        if self._options.maps:
            state["maps"] = [map_images(target.result.maps) for target in self._targets.values()]
        return state
