"""uvicorn's WebSocket connections, with limits on frames per turn, control frames, and the bytes that they hold."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import structlog
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode, Frame
from websockets.protocol import OPEN

from .. import turns
from ..inbox import Inbox
from ..observability.sampled import Sampled
from ..sessions.byte_budget import ByteBudget, Reservation
from ..sessions.rate_limiter import TokenBucket
from ..settings import Settings
from .base import (
    ABORT_EXTENSION,
    LEAVE_EXTENSION,
    LINGER_S,
    OVER_CONNECTION_LIMIT,
    SHARE,
    TOO_MANY_BYTES,
    WRITE_EXTENSION,
    Lingering,
    ended,
)
from .paced_reader import FRAMES_A_TURN, PacedReader
from .whole import BINARY, TEXT, head_of, whole_message

# Messages of one connection that the application gets between two turns.
MESSAGES_A_TURN = 16
LARGE_READ_BYTES = 128 * 1024
# A smaller fragment of a message counts as a control frame does: ordinary clients send larger ones.
SMALL_FRAGMENT_BYTES = 1024
# The memory of a fragment beside its bytes.
FRAGMENT_BYTES = 64

log = Sampled(structlog.get_logger("mfcmt.stream"))


class FrameProtocol(WebSocketsSansIOProtocol):
    """Cuts clients that flood or stop reading, and counts the bytes that the connection holds."""

    settings: Settings
    budget: ByteBudget

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.queue: Inbox[Any] = Inbox()  # type: ignore[assignment]
        self._reader = self.conn.reader = PacedReader()
        self.conn.parser = self.conn.parse()  # reads from the new reader
        next(self.conn.parser)
        self._share = Reservation(self.budget)
        self._idle_frames = TokenBucket(self.settings.max_control_frames_per_s, time.monotonic())
        self._queued_bytes = self._unread_bytes = self._in_a_row = 0
        self._begun_at = 0.0
        self._goes_on = self._served = self._left = False

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the bytes."""
        super().connection_lost(exc)
        ended.count(len(self.connections))
        self._unread_bytes = 0
        self._reader.clear()
        self.frames = []
        self._share.resize(0 if self._served else self._queued_bytes)  # until the application has taken them

    def data_received(self, data: bytes) -> None:
        """Take bytes of frames; frames beyond those of one turn wait for the next one."""
        if self._take_whole(data):
            return
        # Frames that wait for a turn stay in front of these; a frame that comes alone asks for no turn.
        self._reader.turn(0 if self._reader.behind else FRAMES_A_TURN)
        super().data_received(data)
        if self._ends:
            return
        # A large message is read in parts, too: the kernel would hand over megabytes in one turn.
        if self._reader.behind or len(data) > LARGE_READ_BYTES:
            self._pause_reading()
            if not self.queue.messages or self.close_sent:
                self._go_on_later()
        if self._begun_at == 0.0 and (self._reader.held or self.frames):
            self._begun_at = self.loop.time()
        self._count_bytes()

    async def receive(self) -> Any:
        """Return the next message, but only a few in one turn of the loop, and none late in one."""
        messages = self.queue.messages
        if not messages:
            self._in_a_row = 0
            await self.queue.wait()
        elif (in_a_row := self._in_a_row + 1) < MESSAGES_A_TURN:
            self._in_a_row = in_a_row
        else:
            self._in_a_row = 0
            await asyncio.sleep(0)
        message = messages.popleft()
        if messages:
            await turns.give_way()
        else:
            self._queued_bytes = 0
            if self._reader.behind:
                self._go_on_later()
            elif self.read_paused and not self._goes_on and not self._ends:
                self.read_paused = False
                self.transport.resume_reading()
            self._count_bytes()
        return message

    def send_receive_event_to_app(self) -> None:
        """Queue a complete message, and pause reading if the application has not taken the one before.

        Most are taken at once, so reading is not paused for each: that would be two calls of the system.
        """
        parts, self.frames, self._begun_at = self.frames, [], 0.0
        if self.close_sent:
            self._count_frame()
            return
        data = parts[0] if len(parts) == 1 else b"".join(parts)
        if self.queue.messages:
            self._pause_reading()
        if self.curr_msg_data_type == "text":
            try:
                self.queue.put_nowait({"type": "websocket.receive", "text": str(data, "utf-8")})
            except UnicodeDecodeError:
                self.conn.send_close(CloseCode.INVALID_DATA)
                self.handle_parser_exception()
                return
        else:
            self.queue.put_nowait({"type": "websocket.receive", "bytes": data})
        self._queued_bytes += len(data)

    def handle_cont(self, event: Frame) -> None:
        """Take a further fragment of a message."""
        if not event.fin and len(event.data) < SMALL_FRAGMENT_BYTES:
            self._count_frame()
        super().handle_cont(event)

    def handle_ping(self) -> None:
        """Take a ping and answer it with a pong."""
        self._count_frame()
        super().handle_ping()

    def handle_pong(self, event: Frame) -> None:
        """Take a pong, expected or not."""
        self._count_frame()
        super().handle_pong(event)

    def handle_parser_exception(self) -> None:
        """Close a connection whose frames are against the protocol, or too large."""
        assert self.conn.close_sent is not None
        self._refuse(self.conn.close_sent.code, self.conn.close_sent.reason)

    async def run_asgi(self) -> None:
        """Run the application. Its scope has ways to end the connection, and says whether there are too many."""
        extensions: dict[str, Any] = self.scope["extensions"]
        extensions[ABORT_EXTENSION] = self.transport.abort
        extensions[LEAVE_EXTENSION] = self._leave
        extensions[WRITE_EXTENSION] = self.write
        self.scope["state"][SHARE] = self._share
        self.scope["state"][OVER_CONNECTION_LIMIT] = len(self.connections) > self.settings.max_connections
        try:
            await super().run_asgi()
        finally:
            self._served, self._queued_bytes = True, 0
            if self.disconnected:
                self._share.resize(0)

    async def send(self, message: Any) -> None:
        """Send a message. A refused handshake counts as complete, so that uvicorn does not log a fault.

        Raises ClientDisconnected, an OSError, while the connection is being lost.
        """
        if self._ends:
            raise ClientDisconnected
        await super().send(message)
        if self.initial_response is not None and self.close_sent:
            self.handshake_complete = True

    def write(self, message: str | bytes) -> bool:
        """Send a message now. Return False, without having sent it, if the client reads slowly or the stream ends.

        It does what :meth:`send` would, without an event, a future and the copies of a frame for it.
        """
        if self.conn.state is not OPEN or self.close_sent or self._ends or not self.writable.is_set():
            return False
        first, payload = (TEXT, message.encode()) if isinstance(message, str) else (BINARY, message)
        self.transport.write(head_of(payload, first) + payload)
        return True

    def pause_writing(self) -> None:
        """The client reads slower than the service writes: count the bytes that it has not read."""
        super().pause_writing()
        self._unread_bytes = self.transport.get_write_buffer_size()
        self._count_bytes()

    def resume_writing(self) -> None:
        """The client has read everything."""
        super().resume_writing()
        self._unread_bytes = 0
        self._count_bytes()

    def send_keepalive_ping(self) -> None:
        """Send a ping; or cut the connection, if a message was begun and has not ended in time."""
        if self._begun_at and self.loop.time() - self._begun_at > self.settings.body_timeout_s:
            log.info("stream cut", code="deadline-exceeded", detail="a message took too long")
            self.transport.abort()
        else:
            super().send_keepalive_ping()

    def keepalive_timeout(self) -> None:
        """Close the connection, as no pong has come; cut it if the client does not read the close frame either."""
        super().keepalive_timeout()
        self.loop.call_later(LINGER_S, self.transport.abort)

    @property
    def _ends(self) -> bool:
        return self._left or self.transport.is_closing()

    def _take_whole(self, data: bytes) -> bool:
        """Take a message that comes alone and in one piece past the parser; return False for all else."""
        conn = self.conn
        if not self._reader.idle or conn.current_size is not None or conn.state is not OPEN or self._ends:
            return False
        most = conn.max_message_size
        if len(data) > LARGE_READ_BYTES or (message := whole_message(data, most or len(data))) is None:
            return False
        self.curr_msg_data_type, self.frames = "bytes", [message]
        self.send_receive_event_to_app()
        self._count_bytes()
        return True

    def _refuse(self, code: int, reason: str) -> None:
        """End a connection that was failed: tell the application, then the client, whatever that one still sends."""
        self.queue.put_nowait({"type": "websocket.disconnect", "code": code, "reason": reason})
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self._leave()

    def _leave(self) -> None:
        """Send what was written, read no more, and end the connection."""
        if not self._ends:
            self._left = True
            self._reader.clear()
            self.frames = []
            if self.close_timer is not None:
                self.close_timer.cancel()
            # Without a timer of its own, uvicorn closes the connection when the application returns.
            self.close_timer = self.loop.call_later(LINGER_S, self.transport.abort)
            Lingering(self.loop, self.transport, self)

    def _go_on_later(self) -> None:
        if not self._goes_on:
            self._goes_on = True
            turns.later(self.loop, self._go_on)

    def _go_on(self) -> None:
        self._goes_on = self._reader.behind = False
        if not self._ends:
            self.data_received(b"")
            if not self._reader.behind and not self.queue.messages and self.read_paused:
                self.read_paused = False
                self.transport.resume_reading()

    def _pause_reading(self) -> None:
        if not self.read_paused:
            self.read_paused = True
            self.transport.pause_reading()

    def _count_frame(self) -> None:
        """Count a frame without content; cut the connection if there are too many."""
        if self._idle_frames.take(time.monotonic()) and not self._ends:
            log.info("stream cut", code="rate-limited", detail="too many control frames or small fragments")
            self.transport.abort()

    def _count_bytes(self) -> None:
        """Count the bytes that this connection holds; close it if the budget is used up."""
        begun = (self.conn.current_size or 0) + FRAGMENT_BYTES * len(self.frames)
        held = self._reader.held + begun + self._queued_bytes + self._unread_bytes
        if not self._share.resize(held) and not self._ends:
            log.info("stream cut", code="at-capacity", detail=TOO_MANY_BYTES)
            self.conn.fail(CloseCode.TRY_AGAIN_LATER, "at-capacity")
            self._refuse(CloseCode.TRY_AGAIN_LATER, "at-capacity")
