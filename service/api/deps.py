"""What calls are given: the service, who is asking, the media type of the answer.

All are coroutine functions, though none waits: FastAPI runs plain functions in threads, beside the event loop that owns
the sessions, and the way there and back costs more than most calls.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from starlette.requests import Request

from ..keys import Identity
from ..service import Service
from ..sessions.session import Session
from .answers import chosen_type
from .bodies import JSON, MSGPACK


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(_service)]


async def _identity(request: Request) -> Identity:
    # Whoever asks was let in before any route was looked for.
    identity: Identity = request.state.identity
    return identity


IdentityDep = Annotated[Identity, Depends(_identity)]


async def _caller(identity: IdentityDep) -> str:
    return identity.owner


async def _accepted(request: Request) -> str:
    return chosen_type(request, JSON, MSGPACK)


Caller = Annotated[str, Depends(_caller)]
Accepted = Annotated[str, Depends(_accepted)]


async def _session(service: ServiceDep, caller: Caller, session_id: str) -> Session:
    return service.registry.find(caller, session_id)


SessionDep = Annotated[Session, Depends(_session)]
