"""A stream that is attached to a session: one task always reads, another has the frames tracked."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

import structlog

from mfcmt_core.images import sniff

from ..keys import Identity
from ..observability.metrics import Metrics
from ..observability.sampled import Sampled
from ..observability.stages import Stages
from ..problems import ProblemError
from ..schemas.packed import Unreadable
from ..sessions.meter import Meter
from ..sessions.session import Frame, Session
from ..settings import Settings
from .codec import Codec, Event, Refusal
from .flow import Flow, Job
from .messages import Control, Echo, FrameMessage

if TYPE_CHECKING:
    from opentelemetry.trace import Span

# After the last word the socket may be slow to empty; then it is cut.
LINGER_S = 5.0
MAX_UNSENT = 64
NAME_BYTES = 9
MAX_DEBT_S = 1.0

# Refusals that are for what a message says and not for when it comes.
USELESS = ("bad-request", "frame-too-large", "unsupported-image", "stale-frame")

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.stream")
refusals = Sampled(log)


class StreamAttachment:
    """From ``ready`` to the close; the session lives on.

    ``receive`` and ``send`` are those of ASGI, ``abort`` cuts the connection; a fault of ours is told with
    the ``request_id`` of the handshake, and the spans of frames are linked to its ``span``.
    """

    def __init__(
        self,
        session: Session,
        identity: Identity,
        codec: Codec,
        flow: Flow,
        settings: Settings,
        meter: Meter,
        metrics: Metrics,
        receive: Callable[[], Awaitable[Event]],
        send: Callable[[Event], Awaitable[None]],
        abort: Callable[[], None],
        request_id: str,
        span: Span | None,
    ) -> None:
        self.name = secrets.token_urlsafe(NAME_BYTES)
        self.identity = identity
        self._session, self._codec, self._flow = session, codec, flow
        self._settings, self._meter, self._metrics = settings, meter, metrics
        self._receive, self._asgi_send, self._abort = receive, send, abort
        self._request_id, self._span = request_id, span
        # The session's, so that coming back does not fill it.
        self._bucket = session.messages
        self._refused_in_a_row = 0
        self._ending = False
        self._finishing: tuple[int, str] | None = None
        self._in_lane = False
        self._unsent = 0
        self._unsent_since = 0.0
        self._pump_task: asyncio.Task[None] | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def run(self, ready: dict[str, Any]) -> None:
        """Serve the socket until it ends."""
        self._metrics.streams.inc()
        try:
            await self._send(ready)
            if not self._ending:
                self._pump_task = asyncio.create_task(self._pump())
            await self._read()
        except Exception:
            log.exception("fault in a stream", session=self._session.id)
            self._ending = True
            await self._asgi({"type": "websocket.close", "code": 1011, "reason": "internal"})
        finally:
            self._metrics.streams.dec()
            if self._session.attachment is self:
                self._session.attachment = None
                self._session.touch()
            self._halt()
            asyncio.get_running_loop().call_later(LINGER_S, self._abort)
            if self._pump_task is not None:
                await asyncio.wait([self._pump_task])
            self._flow.close()

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message when there is room."""
        self._later(self._send(message))

    def finish(self, code: int, reason: str) -> None:
        """Read no more, answer what has been read, and close."""
        if self._finishing is None:
            self._finishing = code, reason
            self._later(self._finish())  # after what was told before

    def end(self, code: int, reason: str) -> None:
        """Close; the frame in work is finished and kept, what waits is discarded."""
        if self._ending:
            return
        self._metrics.stream_closes.labels(code=code).inc()
        self._halt()
        self._later(self._asgi({"type": "websocket.close", "code": code, "reason": reason}))
        asyncio.get_running_loop().call_later(2 * LINGER_S, self._abort)

    def check(self, now: float) -> None:
        """Cut a connection whose client has stopped reading."""
        stuck = self._unsent and now - self._unsent_since > self._settings.send_timeout_s
        if stuck or self._unsent > MAX_UNSENT:
            log.info("client does not read", session=self._session.id)
            self._halt()
            self._abort()

    def _halt(self) -> None:
        self._ending = True
        self._flow.discard()
        if self._pump_task is not None and not self._in_lane:
            self._pump_task.cancel()

    async def _finish(self) -> None:
        if self._finishing is not None and self._flow.empty and not self._in_lane:
            self.end(*self._finishing)

    def _later(self, work: Any) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _send(self, message: dict[str, Any]) -> None:
        if not self._ending:
            await self._asgi(self._codec.write(message))

    async def _asgi(self, event: Event) -> None:
        if self._unsent == 0:
            self._unsent_since = time.monotonic()
        self._unsent += 1
        # The server raises OSError once the client is gone; the reader will hear of it too.
        with contextlib.suppress(OSError, RuntimeError):
            await self._asgi_send(event)
        self._unsent -= 1
        self._unsent_since = time.monotonic()

    async def _read(self) -> None:
        while True:
            event = await self._receive()
            if event["type"] == "websocket.disconnect":
                return
            if self._ending or self._finishing:
                continue
            arrived = time.monotonic()
            try:
                message = self._codec.read(event)
                if isinstance(message, FrameMessage):
                    await self._take_frame(message, arrived)
                elif message is not None:
                    await self._take_control(message)
                else:
                    self._owe()
            except Unreadable as unreadable:
                self.end(4400, str(unreadable))
            except Refusal as refused:
                self._owe()
                self._count_refusal()
                await self._refuse(refused, ref=refused.ref)
            except ProblemError as problem:
                await self._refuse(problem)

    async def _take_frame(self, message: FrameMessage, arrived: float) -> None:
        session, meta = self._session, message.meta
        self._metrics.stream_frame(len(message.data))
        controls = self._flow.take_for_next()
        seq = meta.seq
        try:
            seq = session.number(seq)
            self._spend(arrived, len(message.data))
            if message.problem is not None:
                raise message.problem
            if len(message.data) > self._settings.max_frame_bytes:
                told = f"{len(message.data)} bytes; at most {self._settings.max_frame_bytes}"
                raise ProblemError("frame-too-large", told)
            if sniff(message.data) is None:
                raise ProblemError("unsupported-image", "not a JPEG, PNG or WebP image")
            queued = time.monotonic()
            self._flow.put_frame(Frame(message.data, seq, meta.ts, meta.region, arrived, queued), controls)
            session.touch()
        except ProblemError as problem:
            self._flow.refused(controls)
            if problem.code in USELESS:
                self._count_refusal()
            for refusal in self._refusals(problem, seq, controls):
                await self._send(refusal)

    async def _take_control(self, control: Control) -> None:
        now = time.monotonic()
        try:
            self._spend(now)
            self._flow.put_control(control)
            self._session.touch()
        except ProblemError as problem:
            self._count_refusal()
            await self._refuse(problem, ref=control.ref)

    def _spend(self, now: float, frame_bytes: int | None = None) -> None:
        """Count a message, which may be a frame. Raises rate-limited, at-capacity; too many in a row end the stream."""
        try:
            if wait_s := self._bucket.take(now):
                raise ProblemError("rate-limited", "too many messages", retry_after_s=round(wait_s, 3))
            if frame_bytes is not None:
                self._meter.frame(self._session.owner, frame_bytes)
        except ProblemError:
            self._refused_in_a_row += 1
            if self._refused_in_a_row > self._settings.max_refused_messages:
                self.end(4429, "too many messages")
            raise
        self._refused_in_a_row = 0

    def _owe(self) -> None:
        """Count a message that has no answer of its own, or is refused anyway."""
        self._bucket.spend(1)
        if self._bucket.wait_s(time.monotonic()) > MAX_DEBT_S:
            self.end(4429, "too many messages")

    def _count_refusal(self) -> None:
        """Count a message that was of no use, for the key: its streams end together where there are too many."""
        if self._meter.refusal(self._session.owner):
            self.end(4429, "too many messages")

    async def _pump(self) -> None:
        while not self._ending:
            job = await self._flow.next()
            self._in_lane = True
            try:
                messages, stages = await self._work(job)
            except Exception:
                log.exception("fault in a stream", session=self._session.id)
                self.end(1011, "internal")
                return
            finally:
                self._in_lane = False
            self._flow.answered(job)
            begun = time.monotonic()
            for message in messages:
                await self._send(message)
            if job.frame is not None and stages is not None:
                sent_s = time.monotonic() - begun
                self._metrics.frame(stages, self._session.id, job.frame.seq, self._span, live=False, sent_s=sent_s)
            await self._finish()

    async def _work(self, job: Job) -> tuple[list[dict[str, Any]], Stages | None]:
        """Have the job done; what the client is told, and the time a tracked frame took."""
        session = self._session
        try:
            if job.frame is None:
                control = job.controls[0]
                await session.control(control.command)
                return [self._targets(control)], None
            commands = [control.command for control in job.controls]
            result, answers, stages = await session.track(job.frame, controls=commands)
        except ProblemError as problem:
            return self._refusals(problem, job.frame.seq if job.frame else None, job.controls), None
        result["dropped"] = self._flow.take_dropped()
        messages = []
        for control, refused in zip(job.controls, answers, strict=True):
            if refused is None:
                messages.append(self._targets(control))
            else:
                messages += self._refusals(refused, None, [control])
        messages.append(result)
        return messages, stages

    def _targets(self, control: Control) -> dict[str, Any]:
        message: dict[str, Any] = {"type": "targets"}
        if control.ref is not None:
            message["ref"] = control.ref
        return message | {"region": self._session.region, "targets": self._session.told_targets()}

    async def _refuse(self, problem: ProblemError, *, ref: Echo = None) -> None:
        await self._send(self._error(problem, ref=ref))

    def _refusals(self, problem: ProblemError, seq: int | None, controls: list[Control]) -> list[dict[str, Any]]:
        """One message for the frame, if there is one, and one for each control."""
        told = [self._error(problem, seq=seq)] if seq is not None or not controls else []
        return told + [self._error(problem, ref=control.ref) for control in controls]

    def _error(self, problem: ProblemError, *, seq: int | None = None, ref: Echo = None) -> dict[str, Any]:
        self._metrics.refused_message(problem.code, frame=seq is not None)
        refusals.info("message refused", session=self._session.id, seq=seq, code=problem.code, detail=problem.detail)
        message: dict[str, Any] = {"type": "error", "problem": problem.body(self._request_id)}
        if seq is not None:
            message["seq"] = seq
        if ref is not None:
            message["ref"] = ref
        return message
