"""A whole session as signed bytes."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from ..sessions.byte_budget import Reservation
from . import contract
from .answers import chosen_type
from .bodies import BYTES, HELD, SNAPSHOT
from .deps import ServiceDep, SessionDep

router = APIRouter(tags=["snapshots"])


@router.get("/sessions/{session_id}/snapshot", **contract.SNAPSHOT)
async def get_snapshot(request: Request, service: ServiceDep, session: SessionDep) -> Response:
    """All targets, `seq` and the newest frame, taken between two frames; post it to `/v1/sessions` to go on."""
    media_type = chosen_type(request, SNAPSHOT, BYTES)
    async with service.snapshot_slots.slot(session.owner):
        contents = await session.snapshot()
        # Held until it is made; what the client does not read of it counts as the connection's.
        share: Reservation = request.scope["state"][HELD]
        share.grow(len(contents))
        # Large: not on the event loop.
        data = await asyncio.to_thread(service.signer.sign, session.owner, contents)
        share.resize(0)
    service.metrics.snapshot_bytes.observe(len(data))
    return Response(data, media_type=media_type)
