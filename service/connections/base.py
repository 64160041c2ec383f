"""Names in a scope, a timer and a slow farewell, for both kinds of connections."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable

from .. import turns

ABORT_EXTENSION = "mfcmt.abort"
# A function that sends what was written, reads no more, and closes.
LEAVE_EXTENSION = "mfcmt.leave"
# A function that sends a message at once and returns True; where it returns False, ASGI's ``send`` waits or says why.
WRITE_EXTENSION = "mfcmt.write"
# In the state of a scope: whether there are more than max_connections.
OVER_CONNECTION_LIMIT = "mfcmt.over_connection_limit"
# In the state of a scope: the connection's share of the byte budget.
SHARE = "mfcmt.share"
TOO_MANY_BYTES = "too many bytes under way; try again in a moment"
# Above this many times max_connections, connections are cut without an answer.
CUT_ABOVE = 2
# A refused client may send for as long before the connection is cut.
LINGER_S = 5.0


class Ended:
    """Has Python look for garbage after a number of connections, whose objects refer to each other.

    By itself it would look when there is ten times as much, for 40 ms in which the event loop does nothing else. A look
    takes longer the more connections are open; with many it is left to Python.
    """

    A_LOOK = 128

    def __init__(self) -> None:
        self._since = 0

    def count(self, still_open: int) -> None:
        """Count a connection that has ended."""
        self._since += 1
        if self._since >= self.A_LOOK:
            self._since = 0
            if still_open < self.A_LOOK:
                gc.collect()


ended = Ended()


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


class Lingering(asyncio.Protocol):
    """Ends a connection in place of the protocol ``before``: what was written is sent, what still comes is discarded.

    If the connection were closed while the client sends, a reset would overtake the answer, and the client would not
    learn why.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, transport: asyncio.Transport, before: asyncio.Protocol) -> None:
        self._loop, self._transport, self._before = loop, transport, before
        self._gone = False
        self._cut = loop.call_later(LINGER_S, transport.abort)
        transport.set_protocol(self)
        if transport.can_write_eof():  # not of TLS
            transport.write_eof()
        transport.resume_reading()

    def data_received(self, data: bytes) -> None:  # noqa: ARG002
        """Discard, and read no more in this turn."""
        self._transport.pause_reading()
        turns.later(self._loop, self._go_on)

    def connection_lost(self, exc: Exception | None) -> None:
        """Let the protocol before clean up."""
        self._gone = True
        self._cut.cancel()
        self._before.connection_lost(exc)

    def pause_writing(self) -> None:
        """The client reads slowly; it has until the cut."""

    def resume_writing(self) -> None:
        """The client has read everything."""

    def _go_on(self) -> None:
        if not self._gone and not self._transport.is_closing():
            self._transport.resume_reading()
