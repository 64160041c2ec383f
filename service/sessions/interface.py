"""What sessions see of others: frames that wait, the stream that is attached, the other nodes."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from ..keys import Identity
from ..protocol.problems import ProblemError
from .database import SessionDatabase

if TYPE_CHECKING:
    from .session import Session


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

    def finish(self, code: int, reason: str, instead: Callable[[], None] | None = None) -> None:
        """Read no more, answer what has been read, and close; or call ``instead``, which sees to the end."""

    def end(self, code: int, reason: str) -> None:
        """Close, and discard what waits."""

    def check(self, now: float) -> None:
        """Cut the connection if the client has stopped reading."""


class SharedNode(Protocol):
    """This node among others that share a store, as its sessions see it."""

    @property
    def database(self) -> SessionDatabase:
        """The store."""

    async def admit(self, owner: str, sid: str) -> int:
        """Count a new session among those that the owner has at all nodes, and return the epoch of its first claim.

        Raises over-quota, and at-capacity if the store has been away for too long.
        """

    async def announce(self, sid: str) -> None:
        """Wait until the other nodes can find a new session, if the store answers."""

    async def once(
        self, owner: str, key: str, data: bytes | memoryview, rest: str, make: Callable[[], Awaitable[str]]
    ) -> str:
        """Return the id of what ``make`` makes, unless a call with this ``key`` came to any node before.

        Raises bad-request if it came with other content, elsewhere if another node has what it made.
        """

    def place_for(self, sid: str) -> str | None:
        """Return the URL of a session's stream at a node that can take it up; None if no other node is there."""

    def another(self) -> ProblemError | None:
        """Return the refusal that sends a creation to a node with a place; None if there is none."""

    def hand_over(self, session: Session) -> None:
        """Begin to save a session whole and give it up; then its stream is closed."""
