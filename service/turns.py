"""Turns of the event loop: who has much to do leaves the rest for the next one, so that others come in between."""

from __future__ import annotations

import asyncio
import time

# After so long a turn no message is parsed or answered any more that can wait for the next one.
MESSAGES_S = 0.004
# HTTP calls give way sooner: frames are in more of a hurry.
CALLS_S = 0.002


class _Turn:
    """When the present turn began: when the first one asked after the loop had come round."""

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._began = 0.0

    def used_up(self, loop: asyncio.AbstractEventLoop, seconds: float) -> bool:
        """Whether the loop's turn has lasted ``seconds``; the caller has to come back in a later one then."""
        if loop is self._loop:
            return time.monotonic() - self._began > seconds
        self._loop, self._began = loop, time.monotonic()
        loop.call_soon(self._end)
        return False

    def _end(self) -> None:
        self._loop = None


_turn = _Turn()
used_up = _turn.used_up


async def give_way(seconds: float) -> None:
    """Go on in this turn if it is young, else in a later one."""
    loop = asyncio.get_running_loop()
    while used_up(loop, seconds):
        await asyncio.sleep(0)
