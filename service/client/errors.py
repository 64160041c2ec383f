"""What the client raises."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class ClientError(Exception):
    """Base of what the client raises."""


class ConnectionLost(ClientError):
    """The server could not be reached, or not again within the time given to reconnecting."""


class Problem(ClientError):
    """The server refused: an RFC 9457 problem of the protocol's catalogue, or a close code that means one.

    ``seq`` or ``ref`` names the stream's message that was refused, ``reason`` how a session ended,
    ``region`` what a region must cover. ``members`` is the whole problem as it came.
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
        self.seq = seq
        self.ref = ref


_BY_CLOSE_CODE: dict[int, dict[str, Any]] = {
    1000: {"code": "session-gone", "status": 410, "reason": "closed"},
    1009: {"code": "frame-too-large", "status": 413},
    4400: {"code": "bad-request", "status": 400},
    4401: {"code": "unauthenticated", "status": 401},
    4403: {"code": "origin-refused", "status": 403},
    4404: {"code": "session-not-found", "status": 404},
    4408: {"code": "session-gone", "status": 410, "reason": "idle"},
    4409: {"code": "attached-elsewhere", "status": 409},
    4410: {"code": "session-gone", "status": 410},
    4429: {"code": "rate-limited", "status": 429},
}


def of_close(code: int, detail: str) -> Problem | None:
    """What the server meant by closing a stream with ``code``; None where reconnecting may help."""
    members = _BY_CLOSE_CODE.get(code)
    return None if members is None else Problem(members | {"detail": detail or f"closed with {code}"})
