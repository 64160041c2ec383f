"""The exceptions of the client."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..protocol.enums import CloseCode, EndReason, ProblemCode
from ..protocol.problems import CATALOGUE


class ClientError(Exception):
    """Base of all exceptions that the client raises."""


class ConnectionLost(ClientError):
    """The service could not be reached, or not again within the time given to reconnecting."""


class Problem(ClientError):
    """The service refused: an RFC 9457 problem of the protocol's catalogue, or a close code that means one.

    Attributes
    ----------
    code, status, detail
        The problem's code, its HTTP status, and what is wrong.
    retry_after_s
        Seconds after which trying again makes sense; None where the service does not say.
    reason
        How a session ended: ``closed``, ``idle``, ``expired`` or ``lost``.
    region
        What a region must cover.
    url
        Where another node has what was asked for.
    seq, ref
        The message of a stream that was refused.
    members
        The whole problem as it came.
    """

    def __init__(self, members: Mapping[str, Any], *, seq: int | None = None, ref: Any = None) -> None:
        self.members = dict(members)
        self.code = str(members.get("code", "internal"))
        self.status = int(members.get("status", 500))
        self.detail = str(members.get("detail", ""))
        super().__init__(f"{self.code}: {self.detail}" if self.detail else self.code)
        self.reason: str | None = members.get("reason")
        self.request_id: str | None = members.get("request_id")
        retry_after = members.get("retry_after_s")
        self.retry_after_s = None if retry_after is None else float(retry_after)
        region = members.get("region")
        self.region: tuple[int, int, int, int] | None = None if region is None else tuple(region)
        self.url: str | None = members.get("url")
        self.seq = seq
        self.ref = ref


# What a close code means; a connection that is closed with any other may be resumed.
_BY_CLOSE_CODE: dict[int, tuple[ProblemCode, EndReason | None]] = {
    CloseCode.SESSION_CLOSED: (ProblemCode.SESSION_GONE, EndReason.CLOSED),
    CloseCode.MESSAGE_TOO_LARGE: (ProblemCode.FRAME_TOO_LARGE, None),
    CloseCode.UNREADABLE: (ProblemCode.BAD_REQUEST, None),
    CloseCode.UNAUTHENTICATED: (ProblemCode.UNAUTHENTICATED, None),
    CloseCode.REFUSED: (ProblemCode.ORIGIN_REFUSED, None),
    CloseCode.NOT_FOUND: (ProblemCode.SESSION_NOT_FOUND, None),
    CloseCode.IDLE: (ProblemCode.SESSION_GONE, EndReason.IDLE),
    CloseCode.ATTACHED_ELSEWHERE: (ProblemCode.ATTACHED_ELSEWHERE, None),
    CloseCode.SESSION_GONE: (ProblemCode.SESSION_GONE, None),
    CloseCode.RATE_LIMITED: (ProblemCode.RATE_LIMITED, None),
}


def of_close(code: int, detail: str) -> Problem | None:
    """Return what the service meant by closing a stream with ``code``; None where reconnecting may help."""
    if code not in _BY_CLOSE_CODE:
        return None
    problem, reason = _BY_CLOSE_CODE[code]
    members = {"code": problem.value, "status": CATALOGUE[problem].status, "detail": detail or f"closed with {code}"}
    return Problem(members if reason is None else members | {"reason": reason.value})
