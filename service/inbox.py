"""What waits for the one task that takes it: messages of a connection, jobs of a stream."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Inbox(Generic[T]):
    """A queue for one task that reads it, at less cost than ``asyncio.Queue``, which it is for uvicorn.

    Attributes
    ----------
    messages : deque
        What waits, the oldest first.
    """

    def __init__(self) -> None:
        self.messages: deque[T] = deque()
        self._come: asyncio.Future[None] | None = None

    def put_nowait(self, message: T) -> None:
        """Add a message."""
        self.messages.append(message)
        if self._come is not None and not self._come.done():
            self._come.set_result(None)

    async def wait(self) -> None:
        """Wait until there is a message."""
        while not self.messages:
            self._come = asyncio.get_running_loop().create_future()
            await self._come
