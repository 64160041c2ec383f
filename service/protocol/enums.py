"""The closed sets of the protocol."""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Self

VERSION = 1
IMAGE_TYPES = ("image/jpeg", "image/png", "image/webp")


class Status(StrEnum):
    """How a target stands in a frame."""

    TRACKING = "tracking"
    UNCERTAIN = "uncertain"
    LOST = "lost"


class Mode(StrEnum):
    """How a stream treats frames that arrive faster than they are tracked."""

    LATEST = "latest"
    LOSSLESS = "lossless"


class Preset(StrEnum):
    """A named configuration of the tracker."""

    DEFAULT = "default"
    PAPER = "paper"


class Resize(StrEnum):
    """What a frame of another size does to a session."""

    REJECT = "reject"
    RESCALE = "rescale"


class TrajectoryFormat(StrEnum):
    """A format in which past results are written."""

    JSON = "json"
    CSV = "csv"
    OTB = "otb"
    MOT = "mot"


class EndReason(StrEnum):
    """Why a session ended."""

    CLOSED = "closed"
    IDLE = "idle"
    EXPIRED = "expired"
    LOST = "lost"


class HealthStatus(StrEnum):
    """Whether the service takes work."""

    OK = "ok"
    STARTING = "starting"
    FAILING = "failing"
    DRAINING = "draining"


class LaneLoss(StrEnum):
    """Why what a lane held for a session is gone, or has to be restored."""

    DIED = "died"
    HUNG = "hung"
    """An operation took longer than its limit."""
    MEMORY = "memory"
    """The lane outgrew its memory limit."""
    START = "start"
    """The lane did not start in time."""
    RELEASED = "released"
    """The session gave up its place."""
    ABSENT = "absent"
    """The session has no lane."""
    RESTART = "restart"
    """The service was started again."""
    FAULT = "fault"
    """It is unknown what the last operation did."""


class ProblemCode(StrEnum):
    """Why a call, a message or a handshake was refused.

    ``problems.CATALOGUE`` has the status and the title of each.
    """

    BAD_REQUEST = "bad-request"
    UNAUTHENTICATED = "unauthenticated"
    ORIGIN_REFUSED = "origin-refused"
    NOT_FOUND = "not-found"
    SESSION_NOT_FOUND = "session-not-found"
    TARGET_NOT_FOUND = "target-not-found"
    METHOD_NOT_ALLOWED = "method-not-allowed"
    NOT_ACCEPTABLE = "not-acceptable"
    ATTACHED_ELSEWHERE = "attached-elsewhere"
    STALE_FRAME = "stale-frame"
    FULL_FRAME_NEEDED = "full-frame-needed"
    SESSION_GONE = "session-gone"
    ELSEWHERE = "elsewhere"
    HOST_REFUSED = "host-refused"
    FRAME_TOO_LARGE = "frame-too-large"
    BODY_TOO_LARGE = "body-too-large"
    UNSUPPORTED_IMAGE = "unsupported-image"
    UNSUPPORTED_MEDIA_TYPE = "unsupported-media-type"
    FRAME_UNDECODABLE = "frame-undecodable"
    FRAME_SIZE_CHANGED = "frame-size-changed"
    BAD_BOX = "bad-box"
    BAD_REGION = "bad-region"
    BAD_SNAPSHOT = "bad-snapshot"
    TOO_MANY_TARGETS = "too-many-targets"
    OVER_CREDIT = "over-credit"
    RATE_LIMITED = "rate-limited"
    OVER_QUOTA = "over-quota"
    INTERNAL = "internal"
    AT_CAPACITY = "at-capacity"
    DRAINING = "draining"
    DEADLINE_EXCEEDED = "deadline-exceeded"


class CloseCode(IntEnum):
    """What the service closes a stream with; ``meaning`` is empty where only handshakes are refused with it."""

    meaning: str

    def __new__(cls, code: int, meaning: str = "") -> Self:
        """Return the member for ``code``."""
        made = int.__new__(cls, code)
        made._value_ = code
        made.meaning = meaning
        return made

    SESSION_CLOSED = 1000, "the session was closed"
    GOING_AWAY = 1001, "the service goes away"
    MESSAGE_TOO_LARGE = 1009, "a message above twice `max_frame_bytes`"
    INTERNAL = 1011, "a fault of the service, or no pong"
    RESTART = 1012, "the service restarts"
    AT_CAPACITY = 1013
    UNREADABLE = 4400, "an unreadable message or the wrong opcode"
    UNAUTHENTICATED = 4401
    REFUSED = 4403
    NOT_FOUND = 4404
    ELSEWHERE = 4307, "`elsewhere`: another node has the session"
    IDLE = 4408, "the session was idle for too long"
    ATTACHED_ELSEWHERE = 4409, "another stream took over"
    SESSION_GONE = 4410, "the session is gone"
    RATE_LIMITED = 4429, "too many messages"
