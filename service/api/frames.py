"""One frame in a call of its own."""

from __future__ import annotations

import time
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from mfcmt_core.images import sniff

from ..problems import ProblemError
from ..schemas import fields
from ..sessions.session import Frame, Session
from . import bodies, contract
from .answers import answer
from .deps import Accepted, ServiceDep, SessionDep

router = APIRouter(tags=["frames"])
REGION = r"^-?[0-9]{1,7}(,-?[0-9]{1,7}){3}$"


@router.post("/sessions/{session_id}/frames", **contract.POST_FRAME)
async def post_frame(
    request: Request,
    service: ServiceDep,
    session: SessionDep,
    accepted: Accepted,
    seq: Annotated[int | None, Query(ge=0, le=fields.MAX_SEQ, description="the frame's number")] = None,
    ts: Annotated[str | None, Query(max_length=64, description="echoed, never interpreted")] = None,
    region: Annotated[str | None, Query(pattern=REGION, description="`x,y,w,h` in whole pixels")] = None,
) -> Response:
    """Track all targets in the next frame. Frames of one session are answered one after the other."""
    arrived = time.monotonic()
    number = seq
    try:
        service.rate_limiter.count_frame(session.owner)
        with session.in_use():
            upload = await bodies.read_upload(request, service.settings, raw=True)
        service.rate_limiter.count_bytes(session.owner, len(upload.frame))
        service.metrics.http_frame(len(upload.frame))
        told = {"ts": ts, "region": region and [int(v) for v in region.split(",")]} | upload.fields
        number = fields.seq(told.pop("seq", seq))
        echo, cut = fields.echo("ts", told.pop("ts")), fields.region(told.pop("region"))
        frame = Frame(upload.frame, 0, echo, cut, arrived, time.monotonic())
        bodies.nothing_more(told, "frame", "seq", "ts", "region")
        _check_free(session, service.settings.credit_frames)
        if sniff(frame.data) is None:
            raise ProblemError("unsupported-image", "not a JPEG, PNG or WebP image")
    except ProblemError:
        session.number(number)  # a refused frame has its number too
        raise
    frame.seq = session.number(number)
    session.http_waiting += 1
    try:
        result, _, stages = await session.track(frame)
    finally:
        session.http_waiting -= 1
    service.metrics.frame(stages, session.id, frame.seq, request.scope["state"].get("span"), live=True)
    return answer(accepted, 200, result)


def _check_free(session: Session, most: int) -> None:
    if session.attachment is not None:
        raise ProblemError("attached-elsewhere", "a stream is attached")
    if session.http_waiting >= most:
        raise ProblemError("over-credit", f"at most {most} unanswered frames", retry_after_s=0.1)
