"""Sessions: made, restored, listed, looked at, ended."""

from __future__ import annotations

import asyncio
import re
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from ..problems import ProblemError
from ..schemas.session import Options as OptionsModel
from ..service import Service
from ..sessions.session import Options, Session
from ..snapshot_signer import BadSignature
from . import bodies, contract
from .answers import answer
from .deps import Accepted, Caller, ServiceDep, SessionDep

router = APIRouter(tags=["sessions"])
KEY = re.compile(r"[\x21-\x7e]{1,255}")


@router.post("/sessions", status_code=201, **contract.CREATE_SESSION)
async def create_session(request: Request, service: ServiceDep, caller: Caller, accepted: Accepted) -> Response:
    """Make a session from its first frame and one or more boxes, or restore one from a snapshot."""
    settings = service.settings
    key = request.headers.get("idempotency-key")
    if key is not None and not KEY.fullmatch(key):
        raise ProblemError("bad-request", "Idempotency-Key is 1 to 255 printable characters")
    service.rate_limiter.count_frame(caller)
    if bodies.media_type(request) in (bodies.SNAPSHOT, bodies.BYTES):
        snapshot = await bodies.read(request, settings.max_snapshot_bytes, settings)
        service.rate_limiter.count_bytes(caller, len(snapshot))
        try:
            contents = await asyncio.to_thread(service.signer.verify, caller, snapshot)
        except BadSignature as bad:
            raise ProblemError("bad-snapshot", str(bad)) from bad
        session = await service.registry.restore(caller, contents, key)
        return _made(request, service, session, accepted)
    upload = await bodies.read_upload(request, settings, raw=False)
    service.rate_limiter.count_bytes(caller, len(upload.frame))
    told = upload.fields
    boxes = bodies.boxes(told)
    if len(boxes) > settings.max_targets_per_session:
        raise ProblemError("too-many-targets", f"at most {settings.max_targets_per_session} targets")
    options = _options(bodies.checked(OptionsModel, told.pop("options", None) or {}), service)
    bodies.nothing_more(told, "frame", "box", "boxes", "options")
    service.metrics.http_frame(len(upload.frame))
    repeated = await service.registry.repeated(caller, upload.frame, boxes, options, key)
    if repeated is not None:
        # Its frame is not needed any more, and the first may take long.
        upload.frame = b""
        request.scope["state"][bodies.HELD].resize(0)
        session = service.registry.find(caller, await asyncio.shield(repeated))
        return _made(request, service, session, accepted)
    session = await service.registry.create(caller, upload.frame, boxes, options, key)
    return _made(request, service, session, accepted)


@router.get("/sessions", **contract.LIST_SESSIONS)
async def list_sessions(
    request: Request,
    service: ServiceDep,
    caller: Caller,
    accepted: Accepted,
    limit: Annotated[int, Query(ge=1, le=100)] = 50,
    after: Annotated[str, Query(pattern="^[0-9]{0,18}$", description="`next` of the page before")] = "",
) -> Response:
    """The caller's own sessions, oldest first."""
    page, following = service.registry.list_owned(caller, int(after or 0), limit)
    base = str(request.base_url)
    content = {
        "sessions": [service.describe(session, base) for session in page],
        "next": None if following is None else str(following),
    }
    return answer(accepted, 200, content)


@router.get("/sessions/{session_id}", **contract.GET_SESSION)
async def get_session(request: Request, service: ServiceDep, session: SessionDep, accepted: Accepted) -> Response:
    """A session as it is now."""
    return answer(accepted, 200, service.describe(session, str(request.base_url)))


@router.delete("/sessions/{session_id}", status_code=204, **contract.DELETE_SESSION)
async def delete_session(service: ServiceDep, caller: Caller, session_id: str) -> Response:
    """End a session; again 204 for as long as it is remembered."""
    service.registry.close(caller, session_id)
    return Response(status_code=204)


def _made(request: Request, service: Service, session: Session, accepted: str) -> Response:
    location = {"Location": f"/v1/sessions/{session.id}"}
    return answer(accepted, 201, service.describe(session, str(request.base_url)), location)


def _options(told: OptionsModel, service: Service) -> Options:
    idle_s, most = told.idle_timeout_s, service.settings.max_idle_timeout_s
    if idle_s is not None and idle_s > most:
        raise ProblemError("bad-request", f"options.idle_timeout_s: at most {most:g}")
    return Options(
        told.preset,
        told.on_resize,
        told.label,
        told.maps,
        service.settings.idle_timeout_s if idle_s is None else idle_s,
    )
