"""uvicorn's connections, with an end to what is silent, slow or too much."""

from __future__ import annotations

import asyncio
import json
import resource
import secrets
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from .problems import CATALOGUE, MEDIA_TYPE, ProblemError
from .settings import Settings

ABORT_EXTENSION = "mfcmt.abort"
# In the state of a scope: there are more connections than there should be.
CROWDED = "mfcmt.crowded"
# Above this many times max_connections not even a refusal is written.
CUT_ABOVE = 2
ABORT_AFTER_S = 5.0
SPARE_FILES = 256
# The most that comes from a socket at once.
CHUNK_BYTES = 256 * 1024
# A client that reads less than this in send_timeout_s does not read.
LEAST_READ_BYTES = 16 * 1024


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


class CallProtocol(HttpToolsProtocol):
    """uvicorn's HTTP: a head has its time and size, a response its reader, and a bad one a problem."""

    settings: Settings

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The clock of the first head runs from here."""
        super().connection_made(transport)
        self._in_head, self._head_bytes, self._unparsed = False, 0, 0
        self._head_timer, self._write_timer = Timer(self.loop), Timer(self.loop)
        if len(self.connections) > CUT_ABOVE * self.settings.max_connections:
            transport.abort()
        else:
            self._expect_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is left to wait for."""
        self._head_timer.stop()
        self._write_timer.stop()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Bytes of a call, or of what may become one."""
        if self.cycle is None or self.cycle.response_complete:
            self._expect_head()
        super().data_received(data)
        # The parser tells of a header when it is whole; this is for one that never is.
        self._unparsed = self._unparsed + len(data) if self._in_head else 0
        if self._unparsed > self.settings.max_head_bytes + CHUNK_BYTES:
            self.send_400_response("the head is too long")

    def on_message_begin(self) -> None:
        """A head begins; the application is told if there are too many connections."""
        super().on_message_begin()
        self._in_head = True
        self._expect_head()
        self.scope["state"][CROWDED] = len(self.connections) > self.settings.max_connections

    def on_header(self, name: bytes, value: bytes) -> None:
        """One header more."""
        super().on_header(name, value)
        self._head_bytes += len(name) + len(value)
        if self._head_bytes > self.settings.max_head_bytes:
            raise ValueError("the head is too long")

    def on_headers_complete(self) -> None:
        """The head is whole."""
        self._in_head, self._head_bytes = False, 0
        self._head_timer.stop()
        super().on_headers_complete()

    def send_400_response(self, msg: str) -> None:
        """A problem, like every refusal; ``msg`` is uvicorn's own or ours and holds nothing of the request."""
        if self.transport.is_closing():
            return
        kind = CATALOGUE["bad-request"]
        body = json.dumps(ProblemError("bad-request", msg.rstrip(".")).body()).encode()
        head = (
            f"HTTP/1.1 {kind.status} Bad Request\r\ncontent-type: {MEDIA_TYPE}\r\n"
            f"content-length: {len(body)}\r\nx-request-id: {secrets.token_hex(8)}\r\nconnection: close\r\n\r\n"
        )
        self.transport.write(head.encode() + body)
        self.transport.close()

    def pause_writing(self) -> None:
        """The client reads slower than we write."""
        super().pause_writing()
        self._watch_reader()

    def resume_writing(self) -> None:
        """It has caught up."""
        self._write_timer.stop()
        super().resume_writing()

    def on_response_complete(self) -> None:
        """The call is over; what the client has not read may be the last."""
        super().on_response_complete()
        self._watch_closing()

    def timeout_keep_alive_handler(self) -> None:
        """No other call has come."""
        super().timeout_keep_alive_handler()
        self._watch_closing()

    def _watch_closing(self) -> None:
        if self.transport.is_closing() and not self._write_timer.runs:
            self._watch_reader()

    def _expect_head(self) -> None:
        if not self._head_timer.runs:
            self._head_timer.start(self.settings.head_timeout_s, self.transport.abort)

    def _watch_reader(self) -> None:
        unread = self.transport.get_write_buffer_size()

        def look() -> None:
            if self.transport.get_write_buffer_size() > unread - LEAST_READ_BYTES:
                self.transport.abort()
            else:
                self._watch_reader()

        self._write_timer.start(self.settings.send_timeout_s, look)


class FrameProtocol(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket; a client that stops reading cannot keep its connection for ever."""

    settings: Settings

    async def run_asgi(self) -> None:
        """Give the application a way to cut the connection, and tell it if there are too many."""
        extensions: dict[str, Any] = self.scope["extensions"]
        extensions[ABORT_EXTENSION] = self.transport.abort
        self.scope["state"][CROWDED] = len(self.connections) > self.settings.max_connections
        await super().run_asgi()

    async def send(self, message: Any) -> None:
        """As ever; and a refused handshake is complete, so that uvicorn does not log it as a fault."""
        await super().send(message)
        if self.initial_response is not None and self.close_sent:
            self.handshake_complete = True

    def keepalive_timeout(self) -> None:
        """No pong: close, and cut if the close frame finds no reader either."""
        super().keepalive_timeout()
        self.loop.call_later(ABORT_AFTER_S, self.transport.abort)


def protocols(settings: Settings) -> tuple[type[CallProtocol], type[FrameProtocol]]:
    """The two, bound to ``settings``: uvicorn makes an instance of each by itself."""
    members = {"settings": settings}
    return type("Calls", (CallProtocol,), members), type("Frames", (FrameProtocol,), members)


def allow_files(settings: Settings) -> bool:
    """Raise this process' limit of open files to what its connections may need; whether that is allowed."""
    needed = CUT_ABOVE * settings.max_connections + SPARE_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < needed:
        needed = hard
    if soft != resource.RLIM_INFINITY and soft < needed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
    return needed >= settings.max_connections + SPARE_FILES
