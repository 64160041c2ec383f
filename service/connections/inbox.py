"""The messages of a connection that the application has not taken yet."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any


class Inbox:
    """Messages for the one task that reads them; it takes the place of uvicorn's ``asyncio.Queue``, at less cost.

    Attributes
    ----------
    messages : deque
        What waits, the oldest first.
    """

    def __init__(self) -> None:
        self.messages: deque[Any] = deque()
        self._come: asyncio.Future[None] | None = None

    def put_nowait(self, message: Any) -> None:
        """Add a message."""
        self.messages.append(message)
        if self._come is not None and not self._come.done():
            self._come.set_result(None)

    async def wait(self) -> None:
        """Wait until there is a message."""
        while not self.messages:
            self._come = asyncio.get_running_loop().create_future()
            await self._come
