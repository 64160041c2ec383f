"""Frames that wait for their session, and the stream of a session as the session sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from ..keys import Identity


@dataclass(slots=True)
class QueuedFrame:
    """A frame on its way to the lane. ``arrived`` and ``queued`` are seconds of the monotonic clock."""

    data: bytes | memoryview
    seq: int
    ts: float | str | None
    region: list[int] | None
    arrived: float
    queued: float


class AttachedStream(Protocol):
    """The stream that is attached to a session, as the session sees it. Only its owner knows ``name``."""

    name: str
    identity: Identity

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message when there is room."""

    def finish(self, code: int, reason: str) -> None:
        """Read no more, answer what has been read, and close."""

    def end(self, code: int, reason: str) -> None:
        """Close, and discard what waits."""

    def check(self, now: float) -> None:
        """Cut the connection if the client has stopped reading."""
