"""What bridges do with sessions: what the calls of the public API do, without their bodies and answers."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from ..api.frames import check_frame, track_frame
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from ..service import Service
from ..sessions.interface import QueuedFrame
from ..sessions.session import Session

if TYPE_CHECKING:
    from opentelemetry.trace import Span


async def create(
    service: Service, owner: str, data: bytes | memoryview, boxes: list[list[float]], options: Options
) -> Session:
    """Return a new session of ``owner``, started on its first frame. Raises the problems of ``/v1/sessions``."""
    service.rate_limiter.count_bytes(owner, len(data))
    if len(boxes) > (most := service.settings.max_targets_per_session):
        raise ProblemError(ProblemCode.TOO_MANY_TARGETS, f"at most {most} targets")
    service.metrics.http_frame(len(data))
    return await service.registry.create(owner, data, boxes, options, None)


async def track(service: Service, session: Session, data: bytes | memoryview, span: Span | None) -> dict[str, Any]:
    """Return the Result of the next frame of a session. Raises the problems of ``/v1/sessions/{id}/frames``."""
    arrived = time.monotonic()
    service.rate_limiter.count_bytes(session.owner, len(data))
    service.metrics.http_frame(len(data))
    frame = QueuedFrame(data, session.number(None), None, None, arrived, time.monotonic())
    check_frame(service, session, data)
    return await track_frame(service, session, frame, span)


async def restore(service: Service, owner: str, contents: bytes | memoryview) -> Session:
    """Return a session that goes on from a snapshot whose signature was verified. Raises bad-snapshot and others."""
    service.rate_limiter.count_bytes(owner, len(contents))
    return await service.registry.restore(owner, contents, None)
