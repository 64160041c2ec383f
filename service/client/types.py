"""What the server says, as dataclasses. Fields that a newer server adds are ignored."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from os import PathLike
from typing import Any, Literal

Box = tuple[float, float, float, float]
"""``(x, y, w, h)``: pixels of the whole decoded frame, 0-based, top-left corner."""

Region = tuple[int, int, int, int]
"""``(x, y, w, h)`` in whole pixels of the frame."""

Size = tuple[int, int]
"""``(w, h)`` in pixels."""

Image = bytes | bytearray | memoryview | PathLike[str]
"""An encoded image (JPEG, PNG or WebP), or the path of its file."""

Status = Literal["tracking", "uncertain", "lost"]
Mode = Literal["latest", "lossless"]
Wire = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Frame:
    """An encoded frame with what goes beside it.

    ``ts`` is echoed in the result and never interpreted. ``region`` says which part of the frame ``data``
    shows. ``seq`` numbers the frame; by default the client counts on.
    """

    data: bytes
    ts: float | str | None = None
    region: Region | None = None
    seq: int | None = None


@dataclass(frozen=True, slots=True)
class Flags:
    """The three reliability tests of section III-C."""

    fused: bool
    template: bool
    statistical: bool


@dataclass(frozen=True, slots=True)
class Scores:
    """Each peak over its mean of the last ten frames."""

    fused: float
    template: float
    statistical: float


@dataclass(frozen=True, slots=True)
class Target:
    """A target in one frame; ``reliable``, ``flags``, ``scores`` and ``psr`` are None where it started.

    ``psr`` is the peak-to-sidelobe ratio of the fused map. ``maps`` holds the response maps as PNG images by
    name, where the session was made with ``maps``.
    """

    id: int
    box: Box
    status: Status
    reliable: bool | None
    flags: Flags | None
    scores: Scores | None
    psr: float | None
    updated: bool
    scale: float
    maps: Mapping[str, bytes] | None = None

    @classmethod
    def of(cls, wire: Wire) -> Target:
        flags, scores, maps = wire.get("flags"), wire.get("scores"), wire.get("maps")
        return cls(
            wire["id"],
            tuple(wire["box"]),
            wire["status"],
            wire.get("reliable"),
            Flags(flags["fused"], flags["template"], flags["statistical"]) if flags else None,
            Scores(scores["fused"], scores["template"], scores["statistical"]) if scores else None,
            wire.get("psr"),
            bool(wire.get("updated", False)),
            float(wire.get("scale", 1.0)),
            {name: _bytes(image) for name, image in maps.items()} if maps else None,
        )


@dataclass(frozen=True, slots=True)
class Timing:
    """Where the server spent its time, in milliseconds."""

    queue_ms: float
    decode_ms: float
    track_ms: float


@dataclass(frozen=True, slots=True)
class Result:
    """What the trackers found in one frame.

    ``dropped`` counts the frames that newer ones replaced since the previous result; ``region`` is the part
    of the coming frames that is needed. A result that was fetched after a reconnect has no ``timing``.
    """

    seq: int
    ts: float | str | None
    size: Size
    dropped: int
    region: Region | None
    targets: tuple[Target, ...]
    timing: Timing | None

    @property
    def target(self) -> Target:
        """The first target."""
        return self.targets[0]

    @classmethod
    def of(cls, wire: Wire) -> Result:
        timing = wire.get("timing")
        return cls(
            wire["seq"],
            wire.get("ts"),
            tuple(wire["size"]),
            wire.get("dropped", 0),
            _region(wire.get("region")),
            tuple(Target.of(t) for t in wire["targets"]),
            Timing(timing["queue_ms"], timing["decode_ms"], timing["track_ms"]) if timing else None,
        )


@dataclass(frozen=True, slots=True)
class SessionInfo:
    """A session as the server knows it; ``seq`` is the last frame tracked."""

    id: str
    created_at: datetime
    expires_at: datetime
    label: str | None
    preset: str
    size: Size
    seq: int
    region: Region | None
    targets: tuple[Target, ...]
    stream_url: str
    attached: bool

    @classmethod
    def of(cls, wire: Wire) -> SessionInfo:
        return cls(
            wire["id"],
            _instant(wire["created_at"]),
            _instant(wire["expires_at"]),
            wire.get("label"),
            wire["preset"],
            tuple(wire["size"]),
            wire["seq"],
            _region(wire.get("region")),
            tuple(Target.of(t) for t in wire["targets"]),
            wire["stream"]["url"],
            wire["stream"]["attached"],
        )


@dataclass(frozen=True, slots=True)
class TargetChange:
    """A target that was added or corrected, and the region that is needed from now on."""

    target: Target
    region: Region | None

    @classmethod
    def of(cls, wire: Wire) -> TargetChange:
        return cls(Target.of(wire["target"]), _region(wire.get("region")))


@dataclass(frozen=True, slots=True)
class Ticket:
    """Admits one handshake of one session."""

    ticket: str
    expires_at: datetime

    @classmethod
    def of(cls, wire: Wire) -> Ticket:
        return cls(wire["ticket"], _instant(wire["expires_at"]))


@dataclass(frozen=True, slots=True)
class Ready:
    """The first message of an attachment.

    ``credit`` is how many frames may wait for their answer, None in ``latest``. ``next_seq`` is the number
    that the next frame takes; ``attachment`` lets its owner, and nobody else, end this attachment when it is
    left behind dead. ``lost_after``, after a breakdown of the service, is the last frame that the session
    knows: what it learned from later ones is lost.
    """

    session: SessionInfo
    mode: Mode
    credit: int | None
    region_lag: int
    next_seq: int
    attachment: str | None
    lost_after: int | None = None

    @classmethod
    def of(cls, wire: Wire) -> Ready:
        session = SessionInfo.of(wire["session"])
        return cls(
            session,
            wire["mode"],
            wire.get("credit"),
            wire.get("region_lag", 1),
            wire.get("next_seq", session.seq + 1),
            wire.get("attachment"),
            wire.get("lost_after"),
        )


@dataclass(frozen=True, slots=True)
class Targets:
    """The targets after a control or a change over HTTP."""

    ref: Any
    region: Region | None
    targets: tuple[Target, ...]

    @classmethod
    def of(cls, wire: Wire) -> Targets:
        return cls(wire.get("ref"), _region(wire.get("region")), tuple(Target.of(t) for t in wire["targets"]))


@dataclass(frozen=True, slots=True)
class Draining:
    """The server is going away; the session goes on in the next one if it is ``resumable``."""

    reconnect_in_s: float
    resumable: bool


@dataclass(frozen=True, slots=True)
class Resumed:
    """A stream goes on after its connection broke.

    ``seq`` is the last frame that the session knows, ``down_s`` how long the stream was interrupted.
    ``lost_after`` is None when nothing is lost. Else the service broke down: the results with a higher ``seq``
    that the stream has given stand, but the trackers have forgotten what they learned from those frames.
    """

    seq: int
    down_s: float
    lost_after: int | None


def _instant(text: str) -> datetime:
    return datetime.fromisoformat(text)


def _bytes(image: bytes | str) -> bytes:
    return image if isinstance(image, bytes) else b64decode(image)


def _region(wire: Any) -> Region | None:
    return None if wire is None else tuple(wire)
