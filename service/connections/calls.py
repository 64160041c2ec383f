"""uvicorn's HTTP connections, with limits on heads, pipelined calls, unread answers and the bytes that they hold."""

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
from .base import CUT_ABOVE, OVER_CONNECTION_LIMIT, SHARE, TOO_MANY_BYTES, Lingering, Timer, ended

# Bytes that the parser gets at a time where they may hold many pieces: two hundred chunks or fifty calls.
SLICE_BYTES = 1024
# Limits of a head: its request line, one header, and their number.
MAX_URL_BYTES = MAX_HEADER_BYTES = 8192
MAX_HEADERS = 100
# Headers that the handshake's parser reads word by word, and their length together.
LISTS = frozenset({b"connection", b"sec-websocket-protocol", b"sec-websocket-extensions"})
MAX_LIST_BYTES = 2048
# A client that reads less than this in send_timeout_s counts as one that does not read.
LEAST_READ_BYTES = 16 * 1024
# A connection that holds less than this is not counted: max_connections bounds their sum.
SMALL_BYTES = 8192
# The memory of a call that waits for the one before it.
CALL_BYTES = 4096
# Some clients end a body with an extra line. Empty lines before a call are allowed, but not many.
EMPTY_LINE_BYTES, MAX_EMPTY_LINES = 4, 4

log = Sampled(structlog.get_logger("mfcmt.http"))


class Flow(FlowControl):
    """Pauses reading while bytes wait to be parsed."""

    behind = False

    def resume_reading(self) -> None:
        """Resume reading, unless bytes wait to be parsed."""
        if not self.behind:
            super().resume_reading()


class CallProtocol(HttpToolsProtocol):
    """Parses one call at a time. The bytes behind it wait, and all bytes that the connection holds are counted."""

    settings: Settings
    budget: ByteBudget

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the clock of the first head."""
        super().connection_made(transport)
        self.flow = self._flow = Flow(transport)
        self._rest = b""
        self._in_head = self._in_body = self._feeds = self._upgraded = self._gone = False
        self._head_bytes = self._unparsed = self._body_left = self._unread_bytes = self._empty_lines = (
            self._list_bytes
        ) = 0
        self._share = Reservation(self.budget)
        self._head_timer, self._write_timer = Timer(self.loop), Timer(self.loop)
        if len(self.connections) > CUT_ABOVE * self.settings.max_connections:
            transport.abort()
        else:
            self._expect_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop all clocks and release the bytes."""
        self._head_timer.stop()
        self._write_timer.stop()
        self._gone, self._rest = True, b""
        self._share.resize(0)
        super().connection_lost(exc)
        ended.count(len(self.connections))

    def data_received(self, data: bytes) -> None:
        """Take the bytes of a call, or of one that begins."""
        if self.cycle is None or self.cycle.response_complete:
            self._expect_head()
        self._rest = self._rest + data if self._rest else data
        self._feed(in_turn=False)

    def handle_websocket_upgrade(self) -> None:
        """Hand the connection over to the WebSocket protocol, with reading resumed."""
        self._upgraded = True
        self._flow.behind = False
        self._flow.resume_reading()
        self._share.resize(0)
        super().handle_websocket_upgrade()

    def on_message_begin(self) -> None:
        """Begin a head. The scope says whether there are too many connections."""
        super().on_message_begin()
        self._in_head, self._head_bytes, self._unparsed, self._body_left = True, 0, 0, 0
        self._empty_lines = self._list_bytes = self._share.elsewhere = 0
        self._expect_head()
        self._share.assign(ANONYMOUS)
        self.scope["state"][SHARE] = self._share
        self.scope["state"][OVER_CONNECTION_LIMIT] = len(self.connections) > self.settings.max_connections

    def on_url(self, url: bytes) -> None:
        """Take a piece of the request line. Raises ValueError if the line is too long."""
        super().on_url(url)
        if len(self.url) > MAX_URL_BYTES:
            raise ValueError("the request line is too long")

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header. Raises ValueError if the head is too long."""
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
        """End the head."""
        self._in_head, self._in_body = False, True
        self._head_timer.stop()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        self._body_left -= len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """End the call."""
        self._in_body = False
        super().on_message_complete()

    def send_400_response(self, msg: str) -> None:
        """Refuse the call with a problem. ``msg`` holds nothing of the request."""
        problem = ProblemError(ProblemCode.BAD_REQUEST, msg.rstrip("."))
        log.info("call refused", code=problem.code, detail=problem.detail)
        self._refuse(problem)

    def pause_writing(self) -> None:
        """The client reads slower than the service writes: count the bytes that it has not read."""
        super().pause_writing()
        self._unread_bytes = self.transport.get_write_buffer_size()
        self._count_bytes()
        self._watch_reader()

    def resume_writing(self) -> None:
        """The client has read everything."""
        self._write_timer.stop()
        super().resume_writing()
        self._unread_bytes = 0
        self._count_bytes()

    def on_response_complete(self) -> None:
        """End the answer, and parse the next call if there is one."""
        super().on_response_complete()
        self._watch_closing()
        if self._rest and not self.pipeline:
            self._feed_later()
        else:
            self._count_bytes()

    def timeout_keep_alive_handler(self) -> None:
        """Close the connection: no other call has come in time."""
        super().timeout_keep_alive_handler()
        self._watch_closing()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: Any) -> None:
        """Start the application; messages that it sends while the connection is being lost are dropped."""

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
            # The parser reports a header when it is complete; this bounds one that never is.
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
        """Return where the next slice for the parser ends: before the next call, as far as that is known."""
        if self._in_body:
            return min(len(data), at + max(SLICE_BYTES, self._body_left))
        end = data.find(b"\r\n\r\n", at, at + SLICE_BYTES)
        return min(len(data), at + SLICE_BYTES) if end < 0 else end + 4

    def _feed_later(self) -> None:
        if not self._feeds:
            self._feeds = True
            turns.later(self.loop, self._feed)

    def _count_bytes(self) -> None:
        """Count the bytes that this connection holds; refuse the call if the budget is used up."""
        if self._gone:
            return
        body = 0 if self.cycle is None else len(self.cycle.body)
        held = len(self._rest) + self._unparsed + body + self._unread_bytes + CALL_BYTES * len(self.pipeline)
        if not self._share.resize(held if held > SMALL_BYTES else 0) and not self.transport.is_closing():
            log.info("call refused", code=ProblemCode.AT_CAPACITY.value, detail=TOO_MANY_BYTES)
            self._rest = b""
            if self._unread_bytes or (self._in_work and self._in_work.response_started):
                self.transport.abort()
            else:
                if self._in_work or self._in_head:
                    self._write_refusal(ProblemError(ProblemCode.AT_CAPACITY, TOO_MANY_BYTES, retry_after_s=1.0))
                self._linger()

    @property
    def _in_work(self) -> RequestResponseCycle | None:
        """The call that is not answered whole yet, if there is one."""
        return None if self.cycle is None or self.cycle.response_complete else self.cycle

    def _linger(self) -> None:
        """End the connection once the client has seen the answer."""
        self._gone = True
        self._share.resize(0)
        self._head_timer.stop()
        if (cycle := self._in_work) is not None:
            cycle.disconnected = True
            cycle.message_event.set()
        Lingering(self.loop, self.transport, self)

    def _refuse(self, problem: ProblemError) -> None:
        """Answer without the application, and close the connection."""
        if not self.transport.is_closing():
            self._write_refusal(problem)
            self.transport.close()
            self._watch_closing()

    def _write_refusal(self, problem: ProblemError) -> None:
        kind = CATALOGUE[problem.code]
        body = json.dumps(problem.body()).encode()
        wait = f"retry-after: {round(problem.members['retry_after_s'])}\r\n" if problem.members else ""
        head = (
            f"content-type: {MEDIA_TYPE}\r\n{wait}"
            f"content-length: {len(body)}\r\nx-request-id: {secrets.token_hex(8)}\r\nconnection: close\r\n\r\n"
        )
        self.transport.write(STATUS_LINE[kind.status] + head.encode() + body)

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
