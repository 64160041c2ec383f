"""How many messages a connection may send, and how many of them may be of no use."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..sessions.rate_limiter import RateLimiter
from ..sessions.session import Session

MAX_DEBT_S = 1.0


class MessageLimits:
    """Counts the messages of one connection against the rates of its session and its key.

    Parameters
    ----------
    session
        Its bucket of messages outlives the connection, so that coming back does not fill it.
    meter
        The rates of the session's owner.
    max_refused
        So many messages in a row may be refused for a rate.
    on_exceeded
        Called, perhaps more than once, when the stream is to end.
    """

    def __init__(
        self, session: Session, rate_limiter: RateLimiter, max_refused: int, on_exceeded: Callable[[], None]
    ) -> None:
        self._bucket, self._owner, self._rate_limiter = session.messages, session.owner, rate_limiter
        self._max_refused, self._on_exceeded = max_refused, on_exceeded
        self._refused_in_a_row = 0

    def spend(self, now: float, frame_bytes: int | None = None) -> None:
        """Count a message at the monotonic time ``now``, which may be a frame. Raises rate-limited, at-capacity."""
        try:
            if wait_s := self._bucket.take(now):
                detail = "too many messages"
                raise ProblemError(ProblemCode.RATE_LIMITED, detail, retry_after_s=round(wait_s, 3))
            if frame_bytes is not None:
                self._rate_limiter.count_frame(self._owner, frame_bytes)
        except ProblemError:
            self._refused_in_a_row += 1
            if self._refused_in_a_row > self._max_refused:
                self._on_exceeded()
            raise
        self._refused_in_a_row = 0

    def count_unanswered(self) -> None:
        """Count a message that has no answer of its own, or is refused anyway."""
        self._bucket.spend(1)
        if self._bucket.wait_s(time.monotonic()) > MAX_DEBT_S:
            self._on_exceeded()

    def count_useless(self) -> None:
        """Count a message that was refused for what it says, against the rate of the key and all its streams."""
        if self._rate_limiter.refusal_delay_s(self._owner):
            self._on_exceeded()
