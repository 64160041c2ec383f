"""One frame in a call of its own."""

from __future__ import annotations

import time
from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from ..frames.header import sniff
from ..problems import ProblemError
from ..schemas import fields
from ..sessions.session import Frame, Session
from . import bodies, contract
from .answers import answer
from .deps import Accepted, ServiceDep, SessionDep

router = APIRouter(tags=["frames"])


@router.post("/sessions/{session_id}/frames", **contract.POST_FRAME)
async def post_frame(
    request: Request,
    service: ServiceDep,
    session: SessionDep,
    accepted: Accepted,
    seq: Annotated[str | None, Query(pattern="^[0-9]{1,16}$", description="the frame's number")] = None,
    ts: Annotated[str | None, Query(max_length=64, description="echoed, never interpreted")] = None,
    region: Annotated[str | None, Query(max_length=64, description="`x,y,w,h` in whole pixels")] = None,
) -> Response:
    """Track all targets in the next frame. Frames of one session are answered one after the other."""
    arrived = time.monotonic()
    upload = await bodies.read_upload(request, service.settings, raw=True)
    told: dict[str, Any] = {"ts": ts}
    if seq is not None:
        told["seq"] = int(seq)
    if region is not None:
        told["region"] = [int(v) if v == int(v) else v for v in _finite(bodies.numbers("region", region))]
    told.update(upload.fields)
    meta = {name: told.pop(name, None) for name in ("seq", "ts", "region")}
    bodies.nothing_more(told)
    service.metrics.http_frame(len(upload.frame))
    _check_free(session, service.settings.credit_frames)
    number = session.number(fields.seq(meta["seq"]))
    if sniff(upload.frame) is None:
        raise ProblemError("unsupported-image", "not a JPEG, PNG or WebP image")
    frame = Frame(upload.frame, number, fields.echo("ts", meta["ts"]), fields.region(meta["region"]), arrived)
    session.http_waiting += 1
    try:
        result, _ = await session.track(frame)
    finally:
        session.http_waiting -= 1
    session.touched = time.monotonic()
    return answer(accepted, 200, result)


def _check_free(session: Session, most: int) -> None:
    if session.attachment is not None:
        raise ProblemError("attached-elsewhere", "a stream is attached")
    if session.http_waiting >= most:
        raise ProblemError("over-credit", f"at most {most} unanswered frames", retry_after_s=0.1)


def _finite(values: list[float]) -> list[float]:
    if not all(abs(v) < 1 << 30 for v in values):
        raise ProblemError("bad-request", "region is x,y,w,h")
    return values
