"""Targets: added, corrected, removed, between two frames."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path
from starlette.requests import Request
from starlette.responses import Response

from ..schemas import fields
from ..service import Service
from ..sessions.session import Session
from . import bodies, contract
from .answers import answer
from .deps import Accepted, ServiceDep, SessionDep

router = APIRouter(tags=["targets"])
TargetId = Annotated[int, Path(ge=0, le=fields.MAX_SEQ, description="the target's `id`", examples=[0])]


@router.post("/sessions/{session_id}/targets", status_code=201, **contract.ADD_TARGET)
async def add_target(request: Request, service: ServiceDep, session: SessionDep, accepted: Accepted) -> Response:
    """Start another target on the newest frame."""
    box = await _box(request, service, session)
    return answer(accepted, 201, await _act(session, {"type": "add", "box": box}))


@router.put("/sessions/{session_id}/targets/{target_id}", **contract.CORRECT_TARGET)
async def correct_target(
    request: Request, service: ServiceDep, session: SessionDep, accepted: Accepted, target_id: TargetId
) -> Response:
    """Start a target anew on the newest frame; its `scale` is 1 again."""
    box = await _box(request, service, session)
    return answer(accepted, 200, await _act(session, {"type": "correct", "target": target_id, "box": box}))


@router.delete("/sessions/{session_id}/targets/{target_id}", status_code=204, **contract.REMOVE_TARGET)
async def remove_target(session: SessionDep, target_id: TargetId) -> Response:
    """Stop following a target."""
    await _act(session, {"type": "remove", "target": target_id})
    return Response(status_code=204)


async def _box(request: Request, service: Service, session: Session) -> list[float]:
    with session.in_use():
        told = await bodies.read_map(request, service.settings)
    box = fields.box(told.pop("box", None))
    bodies.nothing_more(told, "box")
    return box


async def _act(session: Session, control: dict[str, Any]) -> dict[str, Any]:
    """The change, told to the stream too if one is attached."""
    target, region = await session.control(control)
    if session.attachment is not None:
        session.attachment.tell({"type": "targets", "region": region, "targets": session.target_maps()})
    return {"target": target, "region": region}
