"""Sessions: created, restored, listed, shown, ended."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Header, Query
from starlette.requests import Request
from starlette.responses import Response

from ..protocol.answers import SessionInfo, SessionPage, message
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..service import Service
from ..sessions.session import Session
from ..snapshot_signer import BadSignature
from . import contract
from .answers import BYTES, SNAPSHOT, content_type
from .bodies import HELD, read
from .deps import Answer, AnswerDep, Caller, ServiceDep, SessionDep
from .uploads import check_new_session, read_upload

router = APIRouter(tags=["sessions"])
IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=255,
        pattern="^[!-~]+$",
        description="the same key and body within ten minutes answers with the same session",
    ),
]
LOCATION = {"Location": {"description": "the session", "schema": {"type": "string"}}}


@router.post(
    "/sessions",
    status_code=201,
    response_model=SessionInfo,
    response_description="the session, with its first frame tracked",
    responses={
        201: {"headers": LOCATION},
        **contract.problems(
            *contract.ANY_CALL,
            *contract.READS_FRAME,
            *contract.NEGOTIATED,
            "bad-box",
            "bad-snapshot",
            "too-many-targets",
            "over-quota",
            "draining",
            "elsewhere",
            "session-gone",  # of a repeated Idempotency-Key
        ),
    },
    openapi_extra=contract.CREATE_BODY,
)
async def create_session(
    request: Request,
    service: ServiceDep,
    caller: Caller,
    answer: AnswerDep,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Create a session from its first frame and one or more boxes, or restore one from a snapshot."""
    service.rate_limiter.count_frame(caller)
    if content_type(request) in (SNAPSHOT, BYTES):
        session = await _restore(request, service, caller, idempotency_key)
    else:
        session = await _create(request, service, caller, idempotency_key)
    location = {"Location": f"{service.settings.node_url}/v1/sessions/{session.id}"}
    return _answer(request, service, session, answer, 201, location)


@router.get(
    "/sessions",
    response_model=SessionPage,
    response_description="a page of sessions",
    responses=contract.problems(*contract.ANY_CALL, *contract.NEGOTIATED, "bad-request"),
)
async def list_sessions(
    request: Request,
    service: ServiceDep,
    caller: Caller,
    answer: AnswerDep,
    limit: Annotated[int, Query(ge=1, le=100)] = 50,
    after: Annotated[str, Query(pattern="^[0-9]{0,18}$", description="`next` of the page before")] = "",
) -> Response:
    """List the caller's own sessions, oldest first."""
    page, following = service.registry.list_owned(caller, int(after or 0), limit)
    sessions = [service.describe(session, str(request.base_url)) for session in page]
    return answer(message(SessionPage, sessions=sessions, next=None if following is None else str(following)))


@router.get(
    "/sessions/{session_id}",
    response_model=SessionInfo,
    response_description="the session",
    responses=contract.problems(*contract.ANY_CALL, *contract.NEGOTIATED, *contract.ON_SESSION),
)
async def get_session(request: Request, service: ServiceDep, session: SessionDep, answer: AnswerDep) -> Response:
    """Show a session as it is now."""
    return _answer(request, service, session, answer)


@router.delete(
    "/sessions/{session_id}",
    status_code=204,
    response_description="ended",
    responses=contract.problems(*contract.ANY_CALL, "session-not-found"),
)
async def delete_session(service: ServiceDep, caller: Caller, session_id: str) -> Response:
    """End a session; answers 204 again for as long as the session is remembered."""
    service.registry.close(caller, session_id)
    return Response(status_code=204)


async def _restore(request: Request, service: Service, caller: str, key: str | None) -> Session:
    """Return the session of a snapshot, restored. Raises bad-snapshot."""
    snapshot = await read(request, service.settings.max_snapshot_bytes, service.settings)
    service.rate_limiter.count_bytes(caller, len(snapshot))
    try:
        contents = await asyncio.to_thread(service.signer.verify, caller, snapshot)
    except BadSignature as bad:
        raise ProblemError(ProblemCode.BAD_SNAPSHOT, str(bad)) from bad
    return await service.registry.restore(caller, contents, key)


async def _create(request: Request, service: Service, caller: str, key: str | None) -> Session:
    """Return the session of a frame and boxes: a new one, or with a repeated ``key`` the one that it made."""
    upload = await read_upload(request, service.settings, raw=False)
    service.rate_limiter.count_bytes(caller, len(upload.frame))
    new = check_new_session(upload, service.settings)
    service.metrics.http_frame(len(new.frame))
    repeated = await service.registry.repeated(caller, new.frame, new.boxes, new.options, key)
    if repeated is None:
        return await service.registry.create(caller, new.frame, new.boxes, new.options, key)
    # The frame of the repetition is not needed, and the first call may take long.
    upload.frame = new.frame = b""
    request.scope["state"][HELD].resize(0)
    return service.registry.find(caller, await asyncio.shield(repeated))


def _answer(
    request: Request,
    service: Service,
    session: Session,
    answer: Answer,
    status: int = 200,
    headers: dict[str, str] | None = None,
) -> Response:
    return answer(service.describe(session, str(request.base_url)), status, headers)
