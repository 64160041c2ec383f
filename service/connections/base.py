"""What both kinds of connections need: names in a scope, and a timer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

ABORT_EXTENSION = "mfcmt.abort"
# Sends what has been written, reads no more, and closes.
LEAVE_EXTENSION = "mfcmt.leave"
# In the state of a scope: there are more connections than there should be.
CROWDED = "mfcmt.crowded"
# In the state of a scope: what the connection holds of the room.
SHARE = "mfcmt.share"
# Above this many times max_connections not even a refusal is written.
CUT_ABOVE = 2


class Timer:
    """One thing to do later, unless it is stopped before."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._handle: asyncio.TimerHandle | None = None

    @property
    def runs(self) -> bool:
        """Whether it waits."""
        return self._handle is not None

    def start(self, seconds: float, do: Callable[[], object]) -> None:
        """Do it after ``seconds``."""
        self.stop()
        self._handle = self._loop.call_later(seconds, do)

    def stop(self) -> None:
        """Do nothing."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
