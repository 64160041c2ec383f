"""Snapshots: whole sessions as signed bytes."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from ..sessions.byte_budget import Reservation
from . import contract
from .answers import BYTES, SNAPSHOT, in_parts, preferred
from .bodies import HELD
from .deps import ServiceDep, SessionDep

# Bytes that are handed to the connection at a time: to hand over megabytes would hold up the event loop.
PART_BYTES = 256 * 1024

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
        # Counts until the call ends: the answer is sent from it.
        share: Reservation = request.scope["state"][HELD]
        share.grow(len(contents))
        # Signing megabytes would hold up the event loop.
        head = await asyncio.to_thread(service.signer.head, session.owner, contents)
    size = len(head) + len(contents)
    service.metrics.snapshot_bytes.observe(size)
    return StreamingResponse(
        in_parts(_parts(head, contents)), media_type=media_type, headers={"Content-Length": str(size)}
    )


def _parts(head: bytes, contents: bytes | memoryview) -> Iterator[bytes | memoryview]:
    yield head
    view = memoryview(contents)
    for at in range(0, len(view), PART_BYTES):
        yield view[at : at + PART_BYTES]
