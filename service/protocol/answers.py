"""What the service sends: answers of HTTP calls, and the messages of a stream.

A class with a ``TYPE`` is a message of a stream, whose map begins with it. Fields in ``OPTIONAL`` are left out where
they are None. Clients ignore fields that they do not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from functools import cache
from typing import Any, ClassVar

from .enums import Mode, Preset
from .target import Target
from .values import ECHO_DOC, REF_DOC, REGION_DOC, SEQ_DOC, Echo, Region, Seq, Size


def _never_null(schema: dict[str, Any]) -> None:
    """Leave null out of a field's schema: the service always has a value, a client may have none."""
    schema |= schema.pop("anyOf")[0]


def _region_by_name(schema: dict[str, Any]) -> None:
    """Refer to the schema of a region: schemathesis does not read ``prefixItems`` inside a problem."""
    schema["anyOf"][0] = {"$ref": "Region"}


@dataclass(frozen=True, slots=True)
class Timing:
    """Where the service spent its time, in milliseconds of the monotonic clock."""

    queue_ms: float = field(metadata={"ge": 0})
    decode_ms: float = field(metadata={"ge": 0})
    track_ms: float = field(metadata={"ge": 0})


@dataclass(frozen=True, slots=True)
class Result:
    """What the trackers found in one frame.

    ``dropped`` counts the frames of this attachment that newer ones superseded since its previous result. A result
    that a client fetched from the trajectory after a reconnect has no ``timing``.
    """

    TYPE: ClassVar = "result"

    seq: Seq = field(metadata=SEQ_DOC)
    ts: Echo | None = field(metadata=ECHO_DOC)
    size: Size
    dropped: int = field(metadata={"ge": 0, "description": "frames superseded since the previous result"})
    region: Region | None = field(metadata=REGION_DOC)
    targets: tuple[Target, ...]
    timing: Timing | None = field(metadata={"json_schema_extra": _never_null})

    @property
    def target(self) -> Target:
        """The first target."""
        return self.targets[0]


@dataclass(frozen=True, slots=True)
class PastResult:
    """One tracked frame of the past."""

    seq: Seq = field(metadata=SEQ_DOC)
    ts: Echo | None = field(metadata=ECHO_DOC)
    size: Size
    region: Region | None = field(metadata=REGION_DOC)
    targets: tuple[Target, ...]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Tracked frames by rising `seq`; the newest one as corrections left it."""

    id: str
    results: tuple[PastResult, ...]


@dataclass(frozen=True, slots=True)
class StreamAddress:
    """Where frames are streamed to."""

    url: str
    attached: bool


@dataclass(frozen=True, slots=True)
class SessionInfo:
    """A session as it is now; `seq` is the last frame tracked."""

    id: str
    created_at: datetime
    expires_at: datetime
    label: str | None
    preset: str = field(metadata={"json_schema_extra": {"enum": [preset.value for preset in Preset]}})
    size: Size
    seq: Seq = field(metadata=SEQ_DOC)
    region: Region | None = field(metadata=REGION_DOC)
    targets: tuple[Target, ...]
    stream: StreamAddress

    @property
    def stream_url(self) -> str:
        """Where frames are streamed to."""
        return self.stream.url

    @property
    def attached(self) -> bool:
        """Whether a stream is attached."""
        return self.stream.attached


@dataclass(frozen=True, slots=True)
class SessionPage:
    """The caller's sessions, oldest first; `next` goes into `after`."""

    sessions: tuple[SessionInfo, ...]
    next: str | None


@dataclass(frozen=True, slots=True)
class TargetChange:
    """A target that was added or corrected, and the region that is needed from now on."""

    target: Target
    region: Region | None = field(metadata=REGION_DOC)


@dataclass(frozen=True, slots=True)
class Ticket:
    """One handshake: offer the subprotocol `mfcmt.ticket.TICKET` beside the one you speak."""

    ticket: str
    expires_at: datetime


@dataclass(frozen=True, slots=True)
class Ready:
    """The first message of the service, once.

    ``credit`` is None in ``latest``. ``attachment`` lets its owner, and nobody else, end this attachment when its
    connection has died. ``lost_after`` is set after a breakdown of the service: what the session learned from later
    frames is lost.
    """

    TYPE: ClassVar = "ready"

    session: SessionInfo
    mode: Mode
    credit: int | None = field(metadata={"description": "unanswered frames allowed; null in `latest`"})
    region_lag: int = field(metadata={"ge": 0, "description": "frames in flight that regions leave room for"})
    next_seq: Seq = field(metadata={"description": "the number that the next frame takes", "examples": [17]})
    attachment: str = field(metadata={"description": "name of this attachment, for `resume`"})
    lost_after: Seq | None = field(
        default=None,
        metadata={
            "description": "after a breakdown of the service, until a frame is tracked: the last frame that the session"
            " knows; what it learned from later ones is lost"
        },
    )


@dataclass(frozen=True, slots=True)
class ProblemDocument:
    """An RFC 9457 problem, with the code that programs decide by."""

    OPTIONAL: ClassVar = ("retry_after_s", "reason", "region", "request_id", "url")

    type: str
    title: str
    status: int = field(metadata={"ge": 300, "le": 599})
    detail: str
    code: str
    retry_after_s: float = field(
        default=0, metadata={"ge": 0, "description": "seconds after which trying again makes sense"}
    )
    reason: str | None = field(default=None, metadata={"description": "how a session ended"})
    region: Region | None = field(
        default=None, metadata={"description": "what a region must cover", "json_schema_extra": _region_by_name}
    )
    request_id: str | None = field(default=None, metadata={"description": "finds a fault of the service in its log"})
    url: str | None = field(default=None, metadata={"description": "where another node has what was asked for"})


@dataclass(frozen=True, slots=True)
class Error:
    """A message was refused and nothing changed; the stream goes on."""

    TYPE: ClassVar = "error"
    OPTIONAL: ClassVar = ("seq", "ref")

    problem: ProblemDocument
    seq: Seq | None = field(default=None, metadata=SEQ_DOC)
    ref: Echo | None = field(default=None, metadata=REF_DOC)


@dataclass(frozen=True, slots=True)
class Targets:
    """The targets after a control, or after a change over HTTP."""

    TYPE: ClassVar = "targets"
    OPTIONAL: ClassVar = ("ref",)

    ref: Echo | None = field(default=None, kw_only=True, metadata=REF_DOC)
    region: Region | None = field(metadata=REGION_DOC)
    targets: tuple[Target, ...]


@dataclass(frozen=True, slots=True)
class Draining:
    """The service shuts down; where sessions outlive it, they are resumed under the same id."""

    TYPE: ClassVar = "draining"
    OPTIONAL: ClassVar = ("url",)

    reconnect_in_s: float = field(metadata={"ge": 0})
    resumable: bool = field(metadata={"description": "whether sessions outlive the process"})
    url: str | None = field(default=None, metadata={"description": "the stream at another node, which takes it over"})


STREAM_MESSAGES = (Ready, Result, Error, Targets, Draining)
"""The messages that a client of a stream may receive, by the order of their first appearance."""


@cache
def field_names(kind: type) -> tuple[str, ...]:
    """Return the names of a message's fields, in the order in which they are sent."""
    return tuple(one.name for one in fields(kind))


def message(kind: type, /, **values: Any) -> dict[str, Any]:
    """Return the map of a message or answer, in the order of its definition.

    Parameters
    ----------
    kind
        The class that defines it.
    **values
        Every field: plain values, and maps for what is nested. Fields in ``OPTIONAL`` that are None are left out.

    Raises
    ------
    KeyError
        A field is missing.
    """
    head, names, optional = _layout(kind)
    if tuple(values) != names:
        values = {name: values[name] for name in names}
    sent = head | values
    for name in optional:
        if sent[name] is None:
            del sent[name]
    return sent


@cache
def _layout(kind: type) -> tuple[dict[str, Any], tuple[str, ...], Sequence[str]]:
    """Return what a message begins with, the names of its fields in order, and those that may be left out."""
    tag = getattr(kind, "TYPE", None)
    return {} if tag is None else {"type": tag}, field_names(kind), getattr(kind, "OPTIONAL", ())


def instant(moment: datetime) -> str:
    """Return an instant as it is sent: RFC 3339, UTC, milliseconds."""
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
