"""Calls whose request or reply has megabytes: few of an owner at once, and in parts, so that others pass them."""

from __future__ import annotations

import asyncio
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from .framing import PART_BYTES, SIZE
from .interface import Buffers

# Large calls of an owner in a lane, from their first part to the end of their reply: this bounds what the lane keeps of
# them, and their part of the socket.
LARGE_OF_OWNER = 2


@dataclass(slots=True, eq=False)
class PendingCall:
    """A call that waits for its reply. ``request`` is what is still to be sent; the number is 0 until any of it was."""

    owner: str
    key: str
    request: Buffers
    answer: asyncio.Future[bytes | memoryview]
    number: int = 0
    large: bool = False

    def fail(self, error: Exception) -> None:
        """Tell who waits that there will be no reply."""
        if not self.answer.done():
            self.answer.set_exception(error)

    def take_part(self) -> Buffers | None:
        """Remove and return the next part to send ahead; None if only the end of the call is left."""
        *head, data = self.request
        if len(data) <= PART_BYTES:
            return None
        size = [] if self.number else [SIZE.pack(sum(map(len, self.request)))]
        rest = memoryview(data)
        self.request = (rest[PART_BYTES:],)
        return (*size, *head, rest[:PART_BYTES])


class LargeCalls:
    """The large calls of one lane before their turn: those that wait, and those whose requests are being sent.

    ``send`` sends a part of a call, and an empty one to take it back; ``on_sent`` takes a call of which only the end is
    left. ``full`` says whether the socket takes no more, ``moved`` when it last took a part, by the monotonic clock.
    """

    def __init__(self, send: Callable[[PendingCall, Buffers], None], on_sent: Callable[[PendingCall], None]) -> None:
        self.full = False
        self.moved = 0.0
        self._send, self._on_sent = send, on_sent
        self._waiting: deque[PendingCall] = deque()
        self._of_owner: Counter[str] = Counter()
        self._sending: deque[PendingCall] = deque()  # a part of each in turn

    @property
    def sends(self) -> bool:
        """Whether a request is being sent."""
        return bool(self._sending)

    def push(self, call: PendingCall) -> None:
        """Begin a call, or have it wait until its owner has fewer."""
        self._waiting.append(call)
        self._begin(call.owner)

    def of_key(self, key: str) -> list[PendingCall]:
        """Return the calls of ``key``."""
        return [call for call in (*self._waiting, *self._sending) if call.key == key]

    def go_on(self) -> None:
        """Send parts as far as the socket takes them."""
        while self._sending and not self.full:
            call = self._sending[0]
            if call.answer.done():
                self.take_back(call)
            elif (part := call.take_part()) is not None:
                self._send(call, part)
                self.moved = time.monotonic()
                self._sending.rotate(-1)
            else:
                self._sending.popleft()
                self._on_sent(call)

    def take_back(self, call: PendingCall) -> None:
        """Give up a call that has not been sent whole; nobody waits for its reply any more."""
        if call in self._waiting:
            self._waiting.remove(call)
            return
        if call in self._sending:
            self._sending.remove(call)
        if call.number:
            self._send(call, ())
        self.end(call)

    def end(self, call: PendingCall) -> None:
        """The reply has come, or will not come: the owner may begin another large call."""
        if call.large:
            self._of_owner -= Counter((call.owner,))
            self._begin(call.owner)

    def clear(self) -> list[PendingCall]:
        """Forget all calls, and return those that had not been sent whole."""
        calls = [*self._waiting, *self._sending]
        for some in (self._waiting, self._sending, self._of_owner):
            some.clear()
        return calls

    def _begin(self, owner: str) -> None:
        waiting = [call for call in self._waiting if call.owner == owner]
        for call in waiting[: LARGE_OF_OWNER - self._of_owner[owner]]:
            self._waiting.remove(call)
            self._of_owner[owner] += 1
            if not self._sending:
                self.moved = time.monotonic()
            self._sending.append(call)
        self.go_on()
