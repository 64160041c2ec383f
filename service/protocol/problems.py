"""The catalogue of problems (RFC 9457), and the exception that refuses with one of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .enums import CloseCode, EndReason, ProblemCode

MEDIA_TYPE = "application/problem+json"
NO_PLACE = "no place for another session"
NO_LANE = "no lane is ready yet: the service has just started; come again in a moment"


@dataclass(frozen=True, slots=True)
class Kind:
    """One row of the catalogue: the HTTP status, the title, an example of a detail, and when it is used."""

    status: int
    title: str
    example: str
    when: str = ""


_C = ProblemCode
CATALOGUE: dict[ProblemCode, Kind] = {
    _C.BAD_REQUEST: Kind(
        400,
        "The request is malformed",
        "a box is four numbers, [x, y, w, h]",
        "the body or message is malformed, an option or field is unknown, or a value has the wrong type",
    ),
    _C.ELSEWHERE: Kind(
        307,
        "Another node has the session",
        "node-2 has the session",
        "another node has the session; `url` is where the same call or stream finds it",
    ),
    _C.UNAUTHENTICATED: Kind(
        401,
        "A valid key or ticket is needed",
        "no key was shown",
        "the key is missing or wrong, or the ticket is spent",
    ),
    _C.ORIGIN_REFUSED: Kind(
        403, "This browser origin is not allowed", "the origin is not on the list", "the `Origin` is not on the list"
    ),
    _C.NOT_FOUND: Kind(404, "Nothing is at this path", "no such path; /docs lists all", "the path does not exist"),
    _C.SESSION_NOT_FOUND: Kind(
        404, "No such session", "no session of this id", "the session never was, or belongs to another key"
    ),
    _C.TARGET_NOT_FOUND: Kind(404, "No such target", "no target 7", "the session has no target of this id"),
    _C.METHOD_NOT_ALLOWED: Kind(
        405, "The path does not support this method", "see Allow", "the path has other methods, which `Allow` lists"
    ),
    _C.NOT_ACCEPTABLE: Kind(
        406, "Not acceptable", "the answer is available as application/json", "`Accept` names no type of the answer"
    ),
    _C.ATTACHED_ELSEWHERE: Kind(
        409,
        "A stream is attached to the session",
        "a stream is attached",
        "a stream is attached and no takeover was asked for",
    ),
    _C.STALE_FRAME: Kind(
        409, "The frame's number is not above the last one", "seq 4 is not above 9", "`seq` is not above the last one"
    ),
    _C.FULL_FRAME_NEEDED: Kind(
        409,
        "The newest frame does not show the target's surroundings",
        "send the whole frame",
        "see Region; `region` is the whole frame",
    ),
    _C.SESSION_GONE: Kind(
        410,
        "The session has ended",
        "the session ended: idle",
        "the session was the caller's and has ended; `reason` says why",
    ),
    _C.HOST_REFUSED: Kind(
        421,
        "The service does not answer to this host name",
        "evil.example is not a name of this service",
        "a service without keys does not answer to this `Host`",
    ),
    _C.FRAME_TOO_LARGE: Kind(
        413,
        "The frame exceeds a limit",
        "9000000 bytes; at most 8388608",
        "the frame's bytes, pixels, side or scans exceed a limit, known before it is decoded",
    ),
    _C.BODY_TOO_LARGE: Kind(
        413, "The body exceeds the limit", "at most 65536 bytes", "a body of another kind is too large"
    ),
    _C.UNSUPPORTED_IMAGE: Kind(
        415, "The image is not JPEG, PNG or WebP", "not a JPEG, PNG or WebP image", "the image is of another kind"
    ),
    _C.UNSUPPORTED_MEDIA_TYPE: Kind(
        415,
        "The body's media type is not supported",
        "Content-Type is one of application/json, application/msgpack",
        "the call does not read a body of this `Content-Type`",
    ),
    _C.FRAME_UNDECODABLE: Kind(
        422,
        "The image cannot be decoded",
        "the jpeg image is damaged",
        "the image is truncated, corrupt, zero-sized or animated",
    ),
    _C.FRAME_SIZE_CHANGED: Kind(
        422,
        "The frame does not have the session's size",
        "640x480 expected, 480x640 sent",
        "the size changed and `on_resize` is `reject`",
    ),
    _C.BAD_BOX: Kind(
        422,
        "The box cannot be tracked",
        "less than a quarter of the box lies in the frame of 640x480; a box is x, y, w, h",
        "the box is not finite, has a side below one pixel, or lies less than a quarter inside the frame",
    ),
    _C.BAD_REGION: Kind(
        422,
        "The region cannot be used",
        "the region does not cover what is needed",
        "see Region; `region` is the part that is needed",
    ),
    _C.BAD_SNAPSHOT: Kind(
        422,
        "The snapshot cannot be restored",
        "the signature does not match",
        "the signature, the format version or the contents are wrong",
    ),
    _C.TOO_MANY_TARGETS: Kind(
        422, "The session has too many targets", "at most 16 targets", "`max_targets_per_session` is reached"
    ),
    _C.OVER_CREDIT: Kind(
        429, "Too many frames are unanswered", "at most 4 unanswered frames", "more than `credit` frames are unanswered"
    ),
    _C.RATE_LIMITED: Kind(
        429, "Too many messages or calls", "slow down", "calls, messages, frames or bytes come faster than a limit"
    ),
    _C.OVER_QUOTA: Kind(
        429,
        "Quota exceeded for this key",
        "at most 1024 sessions of a key",
        "the key has as many sessions or streams as it may have",
    ),
    _C.INTERNAL: Kind(
        500,
        "Internal error",
        "the fault is logged under the request id",
        "a fault of the service; `request_id` finds it in the log",
    ),
    _C.AT_CAPACITY: Kind(
        503,
        "The service is at capacity",
        NO_PLACE,
        "there is no room now, or no lane is ready; a session is refused at once, never queued",
    ),
    _C.DRAINING: Kind(
        503, "The service is shutting down", "the service is shutting down", "the service is shutting down"
    ),
    _C.DEADLINE_EXCEEDED: Kind(
        504, "The operation took too long", "the operation took too long", "one operation took longer than its limit"
    ),
}

# What a refused handshake is closed with where a browser made it; any other problem closes with INTERNAL.
CLOSE_OF_REFUSAL: dict[ProblemCode, CloseCode] = {
    _C.UNAUTHENTICATED: CloseCode.UNAUTHENTICATED,
    _C.HOST_REFUSED: CloseCode.REFUSED,
    _C.ORIGIN_REFUSED: CloseCode.REFUSED,
    _C.NOT_FOUND: CloseCode.NOT_FOUND,
    _C.SESSION_NOT_FOUND: CloseCode.NOT_FOUND,
    _C.ATTACHED_ELSEWHERE: CloseCode.ATTACHED_ELSEWHERE,
    _C.SESSION_GONE: CloseCode.SESSION_GONE,
    _C.RATE_LIMITED: CloseCode.RATE_LIMITED,
    _C.OVER_QUOTA: CloseCode.RATE_LIMITED,
    _C.AT_CAPACITY: CloseCode.AT_CAPACITY,
    _C.DRAINING: CloseCode.AT_CAPACITY,
    _C.BAD_REQUEST: CloseCode.UNREADABLE,
    _C.ELSEWHERE: CloseCode.ELSEWHERE,
}


class ProblemError(Exception):
    """A refusal that changed nothing.

    Parameters
    ----------
    code
        The row of the catalogue.
    detail
        What is wrong with this very call or message, and what to do; anyone may read it.
    ref
        The ``ref`` of the message that is refused, which its ``error`` echoes.
    **members
        Extension members of the problem document, such as ``retry_after_s`` or ``region``.
    """

    def __init__(self, code: ProblemCode, detail: str, *, ref: float | str | None = None, **members: Any) -> None:
        self.code = code
        super().__init__(f"{self.code}: {detail}")
        self.detail = detail
        self.ref = ref
        self.members = members
        self.headers: dict[str, str] = {}

    @property
    def status(self) -> int:
        """The HTTP status."""
        return CATALOGUE[self.code].status

    def body(self, request_id: str | None = None) -> dict[str, Any]:
        """Return the problem document; ``request_id`` goes into it where the fault is the service's own."""
        kind = CATALOGUE[self.code]
        document = {
            "type": f"/docs#{self.code}",
            "title": kind.title,
            "status": kind.status,
            "detail": self.detail,
            "code": self.code.value,
            **self.members,
        }
        if self.code is ProblemCode.INTERNAL and request_id:
            document["request_id"] = request_id
        return document


def session_gone(reason: EndReason | str, detail: str = "") -> ProblemError:
    """Return the refusal of a session that the caller owned and that has ended."""
    return ProblemError(ProblemCode.SESSION_GONE, f"the session ended: {detail or reason}", reason=reason)


def session_not_found() -> ProblemError:
    """Return the refusal of a session that never was or is another key's; the two answer alike."""
    return ProblemError(ProblemCode.SESSION_NOT_FOUND, "no session of this id")


def elsewhere(node: str, url: str) -> ProblemError:
    """Return the refusal of what another node has, and ``url``, where the same call or handshake finds it."""
    problem = ProblemError(ProblemCode.ELSEWHERE, f"{node} has the session", url=url)
    problem.headers["Location"] = url
    return problem
