"""The messages of a connection that the application has not taken yet."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any


class Inbox:
    """What uvicorn uses of an ``asyncio.Queue``, for the one task that reads, at a third of its calls."""

    def __init__(self) -> None:
        self._messages: deque[Any] = deque()
        self._come: asyncio.Future[None] | None = None

    def empty(self) -> bool:
        """Return whether no message waits."""
        return not self._messages

    def put_nowait(self, message: Any) -> None:
        """Add a message."""
        self._messages.append(message)
        if self._come is not None and not self._come.done():
            self._come.set_result(None)

    async def get(self) -> Any:
        """Remove and return the next message, and wait for it if there is none."""
        while not self._messages:
            self._come = asyncio.get_running_loop().create_future()
            await self._come
        return self._messages.popleft()
