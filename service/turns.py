"""Fair turns of the event loop: work that can wait stands in one queue, and the oldest goes first.

A turn is the work of the loop between two polls of its sockets. Without the queue, the first callback of every turn
could use all of it, and the others would wait for as long as that one has work.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from functools import partial

# Once a turn has lasted this long, messages and calls that can wait are left for later turns.
TURN_S = 0.001


class _Turns:
    """The present turn and the queue of what waits for a later one."""

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._began: float | None = None
        self._waiting: deque[Callable[[], object]] = deque()

    def must_wait(self, loop: asyncio.AbstractEventLoop) -> bool:
        """Return whether this turn is used up, or others wait already: the caller's work belongs to :meth:`later`."""
        self._begin(loop)
        assert self._began is not None
        return bool(self._waiting) or time.monotonic() - self._began > TURN_S

    def later(self, loop: asyncio.AbstractEventLoop, do: Callable[[], object]) -> None:
        """Do it in a turn to come, one piece of work in each; it need not ask :meth:`must_wait` before it begins."""
        self._begin(loop)
        self._waiting.append(do)

    async def give_way(self) -> None:
        """Return at once if this turn has time left and nobody waits, else in a turn to come."""
        loop = asyncio.get_running_loop()
        if self.must_wait(loop):
            turn = loop.create_future()
            self.later(loop, partial(_let_through, turn))
            await turn

    def _begin(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin a turn, unless one has begun."""
        if loop is not self._loop:
            self._loop, self._began = loop, None
            self._waiting.clear()
        if self._began is None:
            self._began = time.monotonic()
            loop.call_soon(self._end, loop)

    def _end(self, loop: asyncio.AbstractEventLoop) -> None:
        """The loop has come round; the next turn begins with what has waited longest."""
        if loop is not self._loop:
            return
        self._began = None
        if self._waiting:
            self._begin(loop)
            self._waiting.popleft()()


def _let_through(turn: asyncio.Future[None]) -> None:
    if not turn.done():  # it was not cancelled
        turn.set_result(None)


_turns = _Turns()
must_wait, later, give_way = _turns.must_wait, _turns.later, _turns.give_way
