"""Targets: added, corrected and removed between two frames."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path
from starlette.responses import Response

from ..protocol.answers import TargetChange, message
from ..protocol.requests import BoxBody
from ..protocol.values import MAX_SEQ
from ..sessions.session import Session
from . import contract
from .deps import AnswerDep, BoxDep, SessionDep

router = APIRouter(tags=["targets"])
TargetId = Annotated[int, Path(ge=0, le=MAX_SEQ, description="the target's `id`", examples=[0])]


@router.post(
    "/sessions/{session_id}/targets",
    status_code=201,
    response_model=TargetChange,
    response_description="started on the newest frame",
    responses=contract.problems(*contract.WITH_BOX, "too-many-targets"),
    openapi_extra=contract.body(BoxBody),
)
async def add_target(session: SessionDep, answer: AnswerDep, body: BoxDep) -> Response:
    """Start another target on the newest frame."""
    return answer(await _control(session, {"type": "add", "box": body.box}), 201)


@router.put(
    "/sessions/{session_id}/targets/{target_id}",
    response_model=TargetChange,
    response_description="started anew on the newest frame",
    responses=contract.problems(*contract.WITH_BOX, "target-not-found"),
    openapi_extra=contract.body(BoxBody),
)
async def correct_target(session: SessionDep, answer: AnswerDep, target_id: TargetId, body: BoxDep) -> Response:
    """Start a target anew on the newest frame; its `scale` is 1 again."""
    return answer(await _control(session, {"type": "correct", "target": target_id, "box": body.box}))


@router.delete(
    "/sessions/{session_id}/targets/{target_id}",
    status_code=204,
    response_description="removed",
    responses=contract.problems(
        *contract.ANY_CALL, *contract.ON_SESSION, *contract.IN_LANE, "bad-request", "target-not-found"
    ),
)
async def remove_target(session: SessionDep, target_id: TargetId) -> Response:
    """Stop following a target."""
    await _control(session, {"type": "remove", "target": target_id})
    return Response(status_code=204)


async def _control(session: Session, control: dict[str, Any]) -> dict[str, Any]:
    """Do ``control``, send the new targets to the stream if one is attached, and return the answer."""
    target, region = await session.control(control)
    if session.attachment is not None:
        session.attachment.tell({"type": "targets", "region": region, "targets": session.target_maps()})
    return message(TargetChange, target=target, region=region)
