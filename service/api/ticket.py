"""Tickets: a browser cannot send a key with a WebSocket, so it sends one of these."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from fastapi import APIRouter
from starlette.responses import Response

from ..auth import ticket_name
from ..protocol.answers import Ticket, instant, message
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import TicketBody
from . import contract
from .deps import AnswerDep, IdentityDep, ServiceDep, SessionDep, TicketDep

router = APIRouter(tags=["tickets"])


@router.post(
    "/sessions/{session_id}/ticket",
    status_code=201,
    response_model=Ticket,
    response_description="one handshake",
    responses=contract.problems(*contract.ANY_CALL, *contract.READS_BODY, *contract.NEGOTIATED, *contract.ON_SESSION),
    openapi_extra=contract.body(TicketBody, required=False),
)
async def make_ticket(
    service: ServiceDep, identity: IdentityDep, session: SessionDep, answer: AnswerDep, body: TicketDep
) -> Response:
    """Make a ticket for one handshake on this session's stream."""
    ttl_s = service.settings.ticket_s if body.ttl_s is None else body.ttl_s
    if ttl_s > service.settings.max_ticket_s:
        raise ProblemError(ProblemCode.BAD_REQUEST, f"ttl_s: at most {service.settings.max_ticket_s:g}")
    ticket = service.authenticator.issue(identity, session.id, ttl_s)
    if service.node is not None:
        await service.node.tickets.share(ticket_name(ticket), identity, session.id, ttl_s)
    expires_at = datetime.now(UTC) + timedelta(seconds=ttl_s)
    return answer(message(Ticket, ticket=ticket, expires_at=instant(expires_at)), 201)
