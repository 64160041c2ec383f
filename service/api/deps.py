"""Dependencies of the calls: the service, the caller, the session, typed bodies, the encoder of the answer.

All are coroutine functions, though some never wait: FastAPI runs plain functions in threads, beside the event loop that
owns the sessions, and the way there and back costs more than most calls.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Annotated, Protocol, TypeVar

from fastapi import Depends
from starlette.requests import Request
from starlette.responses import Response

from ..keys import Identity
from ..protocol.requests import BoxBody, TicketBody
from ..protocol.requests import read as read_checked
from ..service import Service
from ..sessions.session import Session
from . import bodies
from .answers import JSON, MSGPACK, encode, preferred

T = TypeVar("T")


class Answer(Protocol):
    """Encodes an answer in the media type that ``Accept`` prefers."""

    def __call__(self, content: object, status: int = 200, headers: dict[str, str] | None = None) -> Response:
        """Return the response."""


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(_service)]


async def _identity(request: Request) -> Identity:
    # The middleware authenticates every caller before it looks for a route.
    identity: Identity = request.state.identity
    return identity


IdentityDep = Annotated[Identity, Depends(_identity)]


async def _caller(identity: IdentityDep) -> str:
    return identity.owner


Caller = Annotated[str, Depends(_caller)]


async def _session(service: ServiceDep, caller: Caller, session_id: str) -> Session:
    return service.registry.find(caller, session_id)


SessionDep = Annotated[Session, Depends(_session)]


async def _answer(request: Request) -> Answer:
    return partial(encode, preferred(request, JSON, MSGPACK))


AnswerDep = Annotated[Answer, Depends(_answer)]


def _body(kind: type[T], check: Callable[[type[T], dict[str, object]], T]) -> Callable[..., Awaitable[T]]:
    """Return a dependency that reads a JSON or MessagePack body as ``kind``; the session does not expire meanwhile."""

    async def body(request: Request, service: ServiceDep, session: SessionDep, answer: AnswerDep) -> T:  # noqa: ARG001
        with session.in_use():
            document = await bodies.read_document(request, service.settings)
        return check(kind, document)

    return body


BoxDep = Annotated[BoxBody, Depends(_body(BoxBody, read_checked))]
TicketDep = Annotated[TicketBody, Depends(_body(TicketBody, bodies.validated))]
