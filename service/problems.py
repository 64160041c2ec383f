"""The catalogue of problems: every way in which a call or a message can be refused (RFC 9457)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

MEDIA_TYPE = "application/problem+json"
NO_PLACE = "no place for another session"
NO_LANE = "no lane is ready yet: the service has just started; come again in a moment"


@dataclass(frozen=True, slots=True)
class Kind:
    """One row of the catalogue: the HTTP status, what it is called and an example of its detail."""

    status: int
    title: str
    example: str


CATALOGUE: dict[str, Kind] = {
    "bad-request": Kind(400, "The request is malformed", "a box is four numbers, [x, y, w, h]"),
    "unauthenticated": Kind(401, "A valid key or ticket is needed", "no key was shown"),
    "origin-refused": Kind(403, "This browser origin is not allowed", "the origin is not on the list"),
    "not-found": Kind(404, "There is nothing at this path", "no such path; /docs has them all"),
    "session-not-found": Kind(404, "There is no such session", "no session of this id"),
    "target-not-found": Kind(404, "There is no such target", "no target 7"),
    "method-not-allowed": Kind(405, "The path does not know this method", "see Allow"),
    "not-acceptable": Kind(406, "None of the accepted media types can be made", "application/json is made"),
    "attached-elsewhere": Kind(409, "A stream is attached to the session", "a stream is attached"),
    "stale-frame": Kind(409, "The frame's number is not above the last", "seq 4 is not above 9"),
    "full-frame-needed": Kind(409, "The newest frame does not show all that is needed", "send the whole frame"),
    "session-gone": Kind(410, "The session has ended", "the session ended: idle"),
    "host-refused": Kind(421, "The service does not answer to this host name", "evil.example is not a name of it"),
    "frame-too-large": Kind(413, "The frame is above a limit", "9000000 bytes; at most 8388608"),
    "body-too-large": Kind(413, "The body is above the limit", "at most 65536 bytes"),
    "unsupported-image": Kind(415, "The image is not JPEG, PNG or WebP", "not a JPEG, PNG or WebP image"),
    "unsupported-media-type": Kind(415, "The body's media type is not known here", "application/json is read"),
    "frame-undecodable": Kind(422, "The image cannot be decoded", "the jpeg image is damaged"),
    "frame-size-changed": Kind(422, "The frame is not of the session's size", "640x480 expected, 480x640 sent"),
    "bad-box": Kind(
        422,
        "The box cannot be tracked",
        "less than a quarter of the box lies in the frame of 640x480; a box is x, y, w, h",
    ),
    "bad-region": Kind(422, "The region cannot be used", "the region does not cover what is needed"),
    "bad-snapshot": Kind(422, "The snapshot cannot be restored", "the signature does not match"),
    "too-many-targets": Kind(422, "The session has too many targets", "at most 16 targets"),
    "over-credit": Kind(429, "Too many frames wait for their answer", "at most 4 unanswered frames"),
    "rate-limited": Kind(429, "Too many messages or calls", "slow down"),
    "over-quota": Kind(429, "The key has as much as it may have", "at most 1024 sessions of a key"),
    "internal": Kind(500, "A fault of the service", "the fault is logged under the request id"),
    "at-capacity": Kind(503, "The service has no room now", NO_PLACE),
    "draining": Kind(503, "The service is going away", "the service is going away"),
    "deadline-exceeded": Kind(504, "The operation took longer than its limit", "the operation took too long"),
}


class ProblemError(Exception):
    """A refusal: ``code`` is a row of the catalogue, ``detail`` and ``members`` may be shown to anyone."""

    def __init__(self, code: str, detail: str, **members: Any) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail
        self.members = members
        self.headers: dict[str, str] = {}

    @property
    def status(self) -> int:
        """The HTTP status."""
        return CATALOGUE[self.code].status

    def body(self, request_id: str | None = None) -> dict[str, Any]:
        """The problem as RFC 9457 writes it; a fault of ours is found again by its request id."""
        kind = CATALOGUE[self.code]
        told = {
            "type": f"/docs#{self.code}",
            "title": kind.title,
            "status": kind.status,
            "detail": self.detail,
            "code": self.code,
            **self.members,
        }
        if self.code == "internal" and request_id:
            told["request_id"] = request_id
        return told


def session_gone(reason: str, detail: str = "") -> ProblemError:
    """The session was the caller's and has ended: ``closed``, ``idle``, ``expired`` or ``lost``."""
    return ProblemError("session-gone", f"the session ended: {detail or reason}", reason=reason)


def session_not_found() -> ProblemError:
    """Never was, or is another's; the two answer alike."""
    return ProblemError("session-not-found", "no session of this id")
