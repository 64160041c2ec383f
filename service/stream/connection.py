"""A stream that is attached to a session: reads messages, queues what is good, and ends the connection."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import structlog

from mfcmt_core.images import sniff

from ..keys import Identity
from ..observability.metrics import Metrics
from ..protocol.codecs import Codec, ReceivedFrame
from ..protocol.documents import Unreadable
from ..protocol.enums import CloseCode, ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Control
from ..sessions.interface import QueuedFrame
from ..sessions.rate_limiter import RateLimiter
from ..sessions.session import Session
from ..settings import Settings
from .frame_queue import FrameQueue
from .message_limits import MessageLimits
from .pump import Pump
from .replies import Replies
from .sender import Event, Sender

if TYPE_CHECKING:
    from opentelemetry.trace import Span

# After its last message a socket may be slow to empty; then it is cut.
LINGER_S = 5.0
NAME_BYTES = 9
# Codes that refuse a frame for what it is, and not for when it comes.
USELESS = frozenset(
    {
        ProblemCode.BAD_REQUEST,
        ProblemCode.FRAME_TOO_LARGE,
        ProblemCode.UNSUPPORTED_IMAGE,
        ProblemCode.STALE_FRAME,
    }
)

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.stream")


class StreamConnection:
    """One attachment, from ``ready`` to the close; the session lives on.

    Parameters
    ----------
    receive, send
        Those of ASGI.
    write
        Sends an encoded message at once, or returns False if ``send`` has to be awaited for it.
    abort
        Cuts the connection.
    request_id
        The handshake's, shown with faults of the service.
    span
        The handshake's, to which the spans of frames are linked; None without tracing.
    """

    def __init__(
        self,
        session: Session,
        identity: Identity,
        codec: Codec,
        queue: FrameQueue,
        settings: Settings,
        rate_limiter: RateLimiter,
        metrics: Metrics,
        receive: Callable[[], Awaitable[Event]],
        send: Callable[[Event], Awaitable[None]],
        write: Callable[[str | bytes], bool],
        abort: Callable[[], None],
        request_id: str,
        span: Span | None,
    ) -> None:
        self.name = secrets.token_urlsafe(NAME_BYTES)
        self.identity = identity
        self._session, self._queue, self._metrics = session, queue, metrics
        self._receive, self._abort = receive, abort
        self._read_message = codec.reader(settings.max_body_bytes)
        self._max_frame_bytes = settings.max_frame_bytes
        self._sender = Sender(codec, send, write, settings.send_timeout_s)
        self._replies = Replies(session, metrics, request_id)
        self._limits = MessageLimits(session, rate_limiter, settings.max_refused_messages, self._end_for_rate)
        self._pump = Pump(session, queue, self._sender, self._replies, metrics, span, self._end_if_finished)
        self._pump_task: asyncio.Task[None] | None = None
        self._finishing: Callable[[], None] | None = None

    async def run(self, ready: dict[str, Any]) -> None:
        """Send ``ready``, then serve the socket until it ends."""
        self._metrics.streams.inc()
        try:
            await self._sender.send(ready)
            if not self._sender.closed:
                self._pump_task = asyncio.create_task(self._run_pump())
            # In a task of its own: each message would wake the coroutines of fifteen layers of the application.
            await asyncio.create_task(self._read())
        except Exception:
            log.exception("fault in a stream", session=self._session.id)
            await self._sender.close(CloseCode.INTERNAL, ProblemCode.INTERNAL)
        finally:
            self._metrics.streams.dec()
            if self._session.attachment is self:
                self._session.attachment = None
                self._session.touch()
            self._halt()
            asyncio.get_running_loop().call_later(LINGER_S, self._abort)
            if self._pump_task is not None:
                await asyncio.wait([self._pump_task])
            self._queue.close()

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message when there is room."""
        self._sender.later(self._sender.send(message))

    def finish(self, code: int, reason: str, instead: Callable[[], None] | None = None) -> None:
        """Read no more, answer what has been read, and close; or call ``instead``, which sees to the end."""
        if self._finishing is None:
            self._finishing = instead or partial(self.end, code, reason)
            self._sender.later(self._finish())

    def end(self, code: int, reason: str) -> None:
        """Close; the frame in work is finished and kept, what waits is discarded."""
        if self._sender.closed:
            return
        self._metrics.stream_closes.labels(code=int(code)).inc()
        self._halt()
        self._sender.later(self._sender.close(code, reason))
        asyncio.get_running_loop().call_later(2 * LINGER_S, self._abort)

    def check(self, now: float) -> None:
        """Cut a connection whose client has stopped reading."""
        if self._sender.is_stuck(now):
            log.info("client does not read", session=self._session.id)
            self._halt()
            self._abort()

    def _halt(self) -> None:
        self._sender.closed = True
        self._queue.discard()
        if self._pump_task is not None and not self._pump.working:
            self._pump_task.cancel()

    async def _finish(self) -> None:
        self._end_if_finished()  # after what was sent before

    def _end_if_finished(self) -> None:
        if self._finishing is not None and self._queue.empty and not self._pump.working:
            self._finishing()

    def _end_for_rate(self) -> None:
        self.end(CloseCode.RATE_LIMITED, "too many messages")

    async def _run_pump(self) -> None:
        try:
            await self._pump.run()
        except Exception:
            log.exception("fault in a stream", session=self._session.id)
            self.end(CloseCode.INTERNAL, ProblemCode.INTERNAL)

    async def _read(self) -> None:
        while True:
            event = await self._receive()
            if event["type"] == "websocket.disconnect":
                return
            if self._sender.closed or self._finishing:
                continue
            arrived = time.monotonic()
            try:
                message = self._read_message(event.get("text"), event.get("bytes"))
            except Unreadable as unreadable:
                self.end(CloseCode.UNREADABLE, str(unreadable))
            except ProblemError as refused:
                self._limits.count_unanswered()
                self._limits.count_useless()
                await self._sender.send(self._replies.error(refused, ref=refused.ref))
            else:
                if isinstance(message, ReceivedFrame):
                    await self._take_frame(message, arrived)
                elif message is not None:
                    await self._take_control(message)
                else:
                    self._limits.count_unanswered()

    async def _take_frame(self, frame: ReceivedFrame, arrived: float) -> None:
        session, meta, size = self._session, frame.meta, len(frame.data)
        self._metrics.stream_frame(size)
        controls = self._queue.take_for_next()
        seq = meta.seq
        try:
            seq = session.number(seq)
            self._limits.spend(arrived, size)
            if frame.problem is not None:
                raise frame.problem
            if size > self._max_frame_bytes:
                raise ProblemError(ProblemCode.FRAME_TOO_LARGE, f"{size} bytes; at most {self._max_frame_bytes}")
            if sniff(frame.data) is None:
                raise ProblemError(ProblemCode.UNSUPPORTED_IMAGE, "not a JPEG, PNG or WebP image")
            region = meta.region and list(meta.region)
            self._queue.put_frame(QueuedFrame(frame.data, seq, meta.ts, region, arrived, time.monotonic()), controls)
            session.touch()
        except ProblemError as problem:
            self._queue.refused(controls)
            if problem.code in USELESS:
                self._limits.count_useless()
            for refusal in self._replies.errors(problem, seq, controls):
                await self._sender.send(refusal)

    async def _take_control(self, control: Control) -> None:
        try:
            self._limits.spend(time.monotonic())
            self._queue.put_control(control)
            self._session.touch()
        except ProblemError as problem:
            self._limits.count_useless()
            await self._sender.send(self._replies.error(problem, ref=control.ref))
