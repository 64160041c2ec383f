"""The sending half of a stream's socket, with an eye on clients that do not read."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine, MutableMapping
from contextlib import suppress
from typing import Any

from ..protocol.codecs import Codec

MAX_UNSENT = 64

Event = MutableMapping[str, Any]


class Sender:
    """Sends messages until it is closed.

    Parameters
    ----------
    codec
        The stream's subprotocol.
    send
        The ASGI ``send`` of the connection.
    write
        Sends an encoded message at once, or returns False; then ``send`` has to be awaited.
    send_timeout_s
        A client that takes nothing for this long counts as stuck.
    """

    def __init__(
        self,
        codec: Codec,
        send: Callable[[Event], Awaitable[None]],
        write: Callable[[str | bytes], bool],
        send_timeout_s: float,
    ) -> None:
        self.closed = False
        self._encode, self._send, self._write, self._timeout_s = codec.encode, send, write, send_timeout_s
        self._unsent = 0
        self._unsent_since = 0.0
        self._tasks: set[asyncio.Task[None]] = set()

    async def send(self, message: dict[str, Any]) -> None:
        """Send a message, unless the sender is closed."""
        if not self.closed:
            encoded = self._encode(message)
            if self._unsent or not self._write(encoded):
                await self._event(websocket_send(encoded))

    async def close(self, code: int, reason: str) -> None:
        """Send the close frame; messages that are sent later are dropped."""
        self.closed = True
        await self._event({"type": "websocket.close", "code": code, "reason": reason})

    def later(self, work: Coroutine[Any, Any, None]) -> None:
        """Run ``work`` in a task of its own, after those that were begun before."""
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def is_stuck(self, now: float) -> bool:
        """Whether the client has stopped reading, at the time ``now`` of the monotonic clock."""
        stuck = self._unsent and now - self._unsent_since > self._timeout_s
        return bool(stuck) or self._unsent > MAX_UNSENT

    async def _event(self, event: Event) -> None:
        if self._unsent == 0:
            self._unsent_since = time.monotonic()
        self._unsent += 1
        # The server raises OSError once the client is gone; the reader notices it too.
        with suppress(OSError, RuntimeError):
            await self._send(event)
        self._unsent -= 1
        self._unsent_since = time.monotonic()


def websocket_send(encoded: str | bytes) -> Event:
    """Return the ASGI event that sends an encoded message."""
    return {"type": "websocket.send", "text" if isinstance(encoded, str) else "bytes": encoded}
