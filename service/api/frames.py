"""Frames over HTTP, one in each call."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from mfcmt_core.images import sniff

from ..protocol.answers import Result
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.values import MAX_SEQ, check_echo, check_region, check_seq
from ..service import Service
from ..sessions.interface import QueuedFrame
from ..sessions.session import Session
from . import contract
from .deps import AnswerDep, ServiceDep, SessionDep
from .uploads import read_upload, refuse_others

if TYPE_CHECKING:
    from opentelemetry.trace import Span

router = APIRouter(tags=["frames"])
REGION = r"^-?[0-9]{1,7}(,-?[0-9]{1,7}){3}$"


@router.post(
    "/sessions/{session_id}/frames",
    response_model=Result,
    response_description="where the targets are",
    responses=contract.problems(
        *contract.ANY_CALL,
        *contract.READS_FRAME,
        *contract.NEGOTIATED,
        *contract.ON_SESSION,
        "attached-elsewhere",
        "stale-frame",
        "frame-size-changed",
        "bad-region",
        "over-credit",
    ),
    openapi_extra=contract.FRAME_BODY,
)
async def post_frame(
    request: Request,
    service: ServiceDep,
    session: SessionDep,
    answer: AnswerDep,
    seq: Annotated[int | None, Query(ge=0, le=MAX_SEQ, description="the frame's number")] = None,
    ts: Annotated[str | None, Query(max_length=64, description="echoed, never interpreted")] = None,
    region: Annotated[str | None, Query(pattern=REGION, description="`x,y,w,h` in whole pixels")] = None,
) -> Response:
    """Track all targets in the next frame. Frames of one session are answered one after the other."""
    arrived = time.monotonic()
    number = seq
    try:
        service.rate_limiter.count_frame(session.owner)
        with session.in_use():
            upload = await read_upload(request, service.settings, raw=True)
        service.rate_limiter.count_bytes(session.owner, len(upload.frame))
        service.metrics.http_frame(len(upload.frame))
        sent = {"ts": ts, "region": region and [int(v) for v in region.split(",")]} | upload.fields
        number = check_seq(sent.pop("seq", seq))
        echo, cut = check_echo("ts", sent.pop("ts")), check_region(sent.pop("region"))
        frame = QueuedFrame(upload.frame, 0, echo, cut, arrived, time.monotonic())
        refuse_others(sent, "frame", "seq", "ts", "region")
        check_frame(service, session, frame.data)
    except ProblemError:
        session.number(number)  # a refused frame has its number too
        raise
    frame.seq = session.number(number)
    return answer(await track_frame(service, session, frame, request.scope["state"].get("span")))


def check_frame(service: Service, session: Session, data: bytes | memoryview) -> None:
    """Refuse a frame that cannot be tracked now, or is no image by its first bytes.

    Raises attached-elsewhere, over-credit, unsupported-image.
    """
    most = service.settings.credit_frames
    if session.attachment is not None:
        raise ProblemError(ProblemCode.ATTACHED_ELSEWHERE, "a stream is attached")
    if session.http_waiting >= most:
        raise ProblemError(ProblemCode.OVER_CREDIT, f"at most {most} unanswered frames", retry_after_s=0.1)
    if sniff(data) is None:
        raise ProblemError(ProblemCode.UNSUPPORTED_IMAGE, "not a JPEG, PNG or WebP image")


async def track_frame(service: Service, session: Session, frame: QueuedFrame, span: Span | None) -> dict[str, Any]:
    """Track all targets in a frame that has its number, count it, and return the Result of the protocol."""
    session.http_waiting += 1
    try:
        result, _, stages = await session.track(frame)
    finally:
        session.http_waiting -= 1
    service.metrics.targets(result["targets"])
    service.metrics.frame(stages, session.id, frame.seq, span, live=True)
    return result
