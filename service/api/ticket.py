"""Tickets: a browser cannot show a key on a WebSocket, so it shows one of these."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from ..problems import ProblemError
from ..schemas.session import TicketBody
from ..service import instant
from . import bodies, contract
from .answers import answer
from .deps import Accepted, IdentityDep, ServiceDep, SessionDep

router = APIRouter(tags=["tickets"])


@router.post("/sessions/{session_id}/ticket", status_code=201, **contract.TICKET)
async def make_ticket(
    request: Request, service: ServiceDep, identity: IdentityDep, session: SessionDep, accepted: Accepted
) -> Response:
    """A ticket for one handshake on this session's stream."""
    body = bodies.checked(TicketBody, await bodies.read_map(request, service.settings))
    ttl_s = service.settings.ticket_s if body.ttl_s is None else body.ttl_s
    if ttl_s > service.settings.max_ticket_s:
        raise ProblemError("bad-request", f"ttl_s: at most {service.settings.max_ticket_s:g}")
    ticket = service.gate.issue(identity, session.id, ttl_s)
    expires_at = datetime.now(UTC) + timedelta(seconds=ttl_s)
    return answer(accepted, 201, {"ticket": ticket, "expires_at": instant(expires_at)})
