"""The task of a stream that has queued frames and controls done, one after the other, and sends the answers."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import structlog

from ..observability.metrics import Metrics
from ..observability.stages import Stages
from ..protocol.problems import ProblemError
from ..protocol.requests import command
from ..sessions.session import Session
from .frame_queue import FrameQueue, Job
from .replies import Replies
from .sender import Sender

if TYPE_CHECKING:
    from opentelemetry.trace import Span

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.stream")


class Pump:
    """Works off ``queue`` until the sender is closed.

    Parameters
    ----------
    span
        The span of the handshake, to which those of frames are linked; None without tracing.
    on_answered
        Called after each answer.
    """

    def __init__(
        self,
        session: Session,
        queue: FrameQueue,
        sender: Sender,
        replies: Replies,
        metrics: Metrics,
        span: Span | None,
        on_answered: Callable[[], None],
    ) -> None:
        self.working = False
        """Whether a job is in the lane right now."""
        self._session, self._queue, self._sender, self._replies = session, queue, sender, replies
        self._metrics, self._span, self._on_answered = metrics, span, on_answered

    async def run(self) -> None:
        """Work until the sender is closed. Raises whatever is a fault of the service."""
        while not self._sender.closed:
            job = await self._queue.next()
            self.working = True
            try:
                messages, stages = await self._do(job)
            finally:
                self.working = False
            self._queue.answered(job)
            begun = time.monotonic()
            for message in messages:
                await self._sender.send(message)
            if job.frame is not None and stages is not None:
                sent_s = time.monotonic() - begun
                self._metrics.frame(stages, self._session.id, job.frame.seq, self._span, live=False, sent_s=sent_s)
            self._on_answered()

    async def _do(self, job: Job) -> tuple[list[dict[str, Any]], Stages | None]:
        """Have ``job`` done; return its answers, and the time that a tracked frame took."""
        session, replies = self._session, self._replies
        try:
            if job.frame is None:
                control = job.controls[0]
                await session.control(command(control))
                return [replies.targets(control)], None
            commands = [command(control) for control in job.controls] if job.controls else None
            result, refusals, stages = await session.track(job.frame, controls=commands)
        except ProblemError as problem:
            return replies.errors(problem, job.frame.seq if job.frame else None, job.controls), None
        self._metrics.targets(result["targets"])
        result["dropped"] = self._queue.take_dropped()
        messages = []
        for control, refused in zip(job.controls, refusals, strict=True):
            messages += replies.errors(refused, None, [control]) if refused else [replies.targets(control)]
        messages.append(result)
        return messages, stages
