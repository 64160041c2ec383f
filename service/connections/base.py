"""Names in a scope, and a timer, for both kinds of connections."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

ABORT_EXTENSION = "mfcmt.abort"
# A function that sends what was written, reads no more, and closes.
LEAVE_EXTENSION = "mfcmt.leave"
# In the state of a scope: whether there are more than max_connections.
OVER_CONNECTION_LIMIT = "mfcmt.over_connection_limit"
# In the state of a scope: the connection's share of the byte budget.
SHARE = "mfcmt.share"
TOO_MANY_BYTES = "too many bytes under way; try again in a moment"
# Above this many times max_connections, connections are cut without an answer.
CUT_ABOVE = 2


class Timer:
    """A function that is called later, unless the timer is stopped before."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._handle: asyncio.TimerHandle | None = None

    @property
    def runs(self) -> bool:
        """Whether the timer waits."""
        return self._handle is not None

    def start(self, seconds: float, do: Callable[[], object]) -> None:
        """Call ``do`` after ``seconds``, in place of what was planned before."""
        self.stop()
        self._handle = self._loop.call_later(seconds, do)

    def stop(self) -> None:
        """Cancel the call."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
