"""Snapshots: whole sessions as signed bytes."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from ..sessions.byte_budget import Reservation
from . import contract
from .answers import BYTES, SNAPSHOT, preferred
from .bodies import HELD
from .deps import ServiceDep, SessionDep

router = APIRouter(tags=["snapshots"])


@router.get(
    "/sessions/{session_id}/snapshot",
    responses={
        200: {
            "description": "the session",
            "content": contract.contents(SNAPSHOT, BYTES, schema=contract.BINARY, example="(signed bytes)"),
        },
        **contract.problems(*contract.ANY_CALL, *contract.NEGOTIATED, *contract.ON_SESSION, *contract.IN_LANE),
    },
    response_class=Response,
)
async def get_snapshot(request: Request, service: ServiceDep, session: SessionDep) -> Response:
    """Get all targets, `seq` and the newest frame as signed bytes; post them to `/v1/sessions` to go on from there."""
    media_type = preferred(request, SNAPSHOT, BYTES)
    async with service.snapshot_slots.slot(session.owner):
        contents = await session.snapshot()
        # Counts until the snapshot is made; from then on the connection counts what the client has not read.
        share: Reservation = request.scope["state"][HELD]
        share.grow(len(contents))
        # Signing megabytes would hold up the event loop.
        data = await asyncio.to_thread(service.signer.sign, session.owner, contents)
        share.resize(0)
    service.metrics.snapshot_bytes.observe(len(data))
    return Response(data, media_type=media_type)
