"""uvicorn's HTTP: a head has its time and size, calls their turn, a response its reader, and a bad one a problem."""

from __future__ import annotations

import asyncio
import json
import secrets
from typing import Any

import structlog
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol, RequestResponseCycle

from .. import turns
from ..observability.sampled import Sampled
from ..protocol.enums import ProblemCode
from ..protocol.problems import CATALOGUE, MEDIA_TYPE, ProblemError
from ..sessions.byte_budget import ANONYMOUS, ByteBudget, Reservation
from ..settings import Settings
from .base import CUT_ABOVE, OVER_CONNECTION_LIMIT, SHARE, Timer

# What the parser is given at a time where it could hold many pieces: two hundred chunks or fifty calls.
SLICE_BYTES = 1024
# Of a head: its request line, one header, and how many of them.
MAX_URL_BYTES = MAX_HEADER_BYTES = 8192
MAX_HEADERS = 100
# What the handshake's parser goes through word by word, all of it together.
LISTS = frozenset({b"connection", b"sec-websocket-protocol", b"sec-websocket-extensions"})
MAX_LIST_BYTES = 2048
# A client that reads less than this in send_timeout_s does not read.
LEAST_READ_BYTES = 16 * 1024
# A connection that holds less than this is not worth counting: max_connections bounds those.
SMALL_BYTES = 8192
# What a call that waits for the one before it takes.
CALL_BYTES = 4096
# Some clients end a body with a line too many; these come in front of a call, two at a time at least.
EMPTY_LINE_BYTES, MAX_EMPTY_LINES = 4, 4

log = Sampled(structlog.get_logger("mfcmt.http"))


class Flow(FlowControl):
    """Reads nothing while something that was read waits to be parsed."""

    behind = False

    def resume_reading(self) -> None:
        """As ever, unless something waits."""
        if not self.behind:
            super().resume_reading()


class CallProtocol(HttpToolsProtocol):
    """One call at a time is parsed; what comes behind it waits, and what a connection holds is counted."""

    settings: Settings
    room: ByteBudget

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The clock of the first head runs from here."""
        super().connection_made(transport)
        self.flow = self._flow = Flow(transport)
        self._rest = b""
        self._in_head = self._in_body = self._feeds = self._upgraded = self._gone = False
        self._head_bytes = self._unparsed = self._body_left = self._unread_bytes = self._empty_lines = (
            self._list_bytes
        ) = 0
        self._share = Reservation(self.room)
        self._head_timer, self._write_timer = Timer(self.loop), Timer(self.loop)
        if len(self.connections) > CUT_ABOVE * self.settings.max_connections:
            transport.abort()
        else:
            self._expect_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is left to wait for."""
        self._head_timer.stop()
        self._write_timer.stop()
        self._gone, self._rest = True, b""
        self._share.resize(0)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Bytes of a call, or of what may become one."""
        if self.cycle is None or self.cycle.response_complete:
            self._expect_head()
        self._rest = self._rest + data if self._rest else data
        self._feed(in_turn=False)

    def handle_websocket_upgrade(self) -> None:
        """As ever; this object has done its work then, and leaves the connection as it reads."""
        self._upgraded = True
        self._flow.behind = False
        self._flow.resume_reading()
        self._share.resize(0)
        super().handle_websocket_upgrade()

    def on_message_begin(self) -> None:
        """A head begins; the application is told if there are too many connections."""
        super().on_message_begin()
        self._in_head, self._head_bytes, self._unparsed, self._body_left = True, 0, 0, 0
        self._empty_lines = self._list_bytes = 0
        self._expect_head()
        self._share.assign(ANONYMOUS)
        self.scope["state"][SHARE] = self._share
        self.scope["state"][OVER_CONNECTION_LIMIT] = len(self.connections) > self.settings.max_connections

    def on_url(self, url: bytes) -> None:
        """A piece of the request line."""
        super().on_url(url)
        if len(self.url) > MAX_URL_BYTES:
            raise ValueError("the request line is too long")

    def on_header(self, name: bytes, value: bytes) -> None:
        """One header more."""
        super().on_header(name, value)
        self._head_bytes += len(name) + len(value)
        if (
            self._head_bytes > self.settings.max_head_bytes
            or len(value) > MAX_HEADER_BYTES
            or len(self.headers) > MAX_HEADERS
        ):
            raise ValueError("the head is too long")
        name = name.lower()
        if name in LISTS:
            self._list_bytes += len(value)
            if self._list_bytes > MAX_LIST_BYTES:
                raise ValueError("the head is too long")
        if name == b"content-length" and value.isdigit():
            self._body_left = int(value[:18])

    def on_headers_complete(self) -> None:
        """The head is whole."""
        self._in_head, self._in_body = False, True
        self._head_timer.stop()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """A piece of a body."""
        self._body_left -= len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """The call is here as a whole."""
        self._in_body = False
        super().on_message_complete()

    def send_400_response(self, msg: str) -> None:
        """A problem, like every refusal; ``msg`` is uvicorn's own or ours and holds nothing of the request."""
        problem = ProblemError(ProblemCode.BAD_REQUEST, msg.rstrip("."))
        log.info("call refused", code=problem.code, detail=problem.detail)
        self._refuse(problem)

    def pause_writing(self) -> None:
        """The client reads slower than we write."""
        super().pause_writing()
        self._unread_bytes = self.transport.get_write_buffer_size()
        self._count_bytes()
        self._watch_reader()

    def resume_writing(self) -> None:
        """It has caught up."""
        self._write_timer.stop()
        super().resume_writing()
        self._unread_bytes = 0
        self._count_bytes()

    def on_response_complete(self) -> None:
        """The call is over; what the client has not read may be the last."""
        super().on_response_complete()
        self._watch_closing()
        if self._rest and not self.pipeline:
            self._feed_later()
        else:
            self._count_bytes()

    def timeout_keep_alive_handler(self) -> None:
        """No other call has come."""
        super().timeout_keep_alive_handler()
        self._watch_closing()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: Any) -> None:
        """As ever; but what is sent while the connection is being lost goes nowhere, and is no fault."""

        async def serve(scope: Any, receive: Any, send: Any) -> None:
            async def tell(message: Any) -> None:
                if self.transport.is_closing() and not cycle.response_complete:
                    cycle.disconnected = True
                await send(message)

            await app(scope, receive, tell)

        super()._start_asgi_task(cycle, serve)

    def _feed(self, *, in_turn: bool = True) -> None:
        """Parse what was read, up to the next call that has to wait or the end of the turn; some of it ``in_turn``."""
        if in_turn:
            self._feeds = False
        if self._gone:
            return
        data, at = self._rest, 0
        while at < len(data) and not (self.pipeline or self.transport.is_closing()):
            if not (in_turn and at == 0) and turns.must_wait(self.loop):
                break
            end = self._end_of_slice(data, at)
            if end <= at + EMPTY_LINE_BYTES and not (self._in_head or self._in_body):
                self._empty_lines += 1
                if self._empty_lines > MAX_EMPTY_LINES:
                    self.send_400_response("too many empty lines")
            super().data_received(data[at:end])
            if self._upgraded:
                if end < len(data):
                    self.transport.get_protocol().data_received(data[end:])  # type: ignore[attr-defined]
                return
            # The parser tells of a header when it is whole; this is for one that never is.
            self._unparsed = self._unparsed + end - at if self._in_head else 0
            if self._unparsed > self.settings.max_head_bytes + SLICE_BYTES:
                self.send_400_response("the head is too long")
            at = end
        self._rest = data[at:]
        if self._rest and not self.transport.is_closing():
            self._flow.behind = True
            self._flow.pause_reading()
            if not self.pipeline:
                self._feed_later()
        elif self._flow.behind:
            self._flow.behind = False
            if not self.pipeline:
                self._flow.resume_reading()
        self._count_bytes()

    def _end_of_slice(self, data: bytes, at: int) -> int:
        """Where to stop before the next call, as far as one can tell without parsing."""
        if self._in_body:
            return min(len(data), at + max(SLICE_BYTES, self._body_left))
        end = data.find(b"\r\n\r\n", at, at + SLICE_BYTES)
        return min(len(data), at + SLICE_BYTES) if end < 0 else end + 4

    def _feed_later(self) -> None:
        if not self._feeds:
            self._feeds = True
            turns.later(self.loop, self._feed)

    def _count_bytes(self) -> None:
        """Hold what is here of this connection; refuse the call if there is no room."""
        if self._gone:
            return
        body = 0 if self.cycle is None else len(self.cycle.body)
        held = len(self._rest) + self._unparsed + body + self._unread_bytes + CALL_BYTES * len(self.pipeline)
        if not self._share.resize(held if held > SMALL_BYTES else 0) and not self.transport.is_closing():
            log.info("call refused", code="at-capacity", detail="too much is under way at once")
            self._rest = b""
            if self._unread_bytes or (self.cycle is not None and self.cycle.response_started):
                self.transport.abort()
            else:
                self._refuse(ProblemError(ProblemCode.AT_CAPACITY, "too much is under way at once", retry_after_s=1.0))

    def _refuse(self, problem: ProblemError) -> None:
        """Answer outside of the application, and close."""
        if self.transport.is_closing():
            return
        kind = CATALOGUE[problem.code]
        body = json.dumps(problem.body()).encode()
        wait = f"retry-after: {round(problem.members['retry_after_s'])}\r\n" if problem.members else ""
        head = (
            f"content-type: {MEDIA_TYPE}\r\n{wait}"
            f"content-length: {len(body)}\r\nx-request-id: {secrets.token_hex(8)}\r\nconnection: close\r\n\r\n"
        )
        self.transport.write(STATUS_LINE[kind.status] + head.encode() + body)
        self.transport.close()
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
