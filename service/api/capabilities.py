"""The limits and abilities of the service."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from fastapi import APIRouter
from starlette.responses import Response

from ..protocol.answers import field_names, message
from ..protocol.capabilities import Capabilities, Limits
from ..protocol.codecs import CODECS
from ..protocol.enums import IMAGE_TYPES, VERSION, Mode, Preset, TrajectoryFormat
from ..service import Service
from ..snapshot_signer import READABLE
from . import contract
from .deps import AnswerDep, Caller, ServiceDep

router = APIRouter(tags=["service"])


@router.get(
    "/capabilities",
    response_model=Capabilities,
    response_description="what this service can do",
    responses=contract.problems(*contract.ANY_CALL, *contract.NEGOTIATED),
)
async def get_capabilities(service: ServiceDep, _caller: Caller, answer: AnswerDep) -> Response:
    """Limits, subprotocols, presets, formats and versions."""
    return answer(capabilities(service))


def capabilities(service: Service) -> dict[str, Any]:
    """Return the Capabilities of the protocol."""
    limits = {name: getattr(service.settings, name) for name in field_names(Limits)}
    shares = service.registry.quotas
    limits |= {"max_sessions_per_key": shares.sessions, "max_streams_per_key": shares.streams}
    lanes = next((status.versions for status in service.lanes.status() if status.versions), {})
    return message(
        Capabilities,
        protocol=VERSION,
        subprotocols=list(CODECS),
        modes=list(Mode),
        presets=list(Preset),
        image_types=list(IMAGE_TYPES),
        trajectory_formats=list(TrajectoryFormat),
        snapshot_versions=list(READABLE),
        limits=limits,
        software={"mfcmt": version("mfcmt")} | lanes,
    )
