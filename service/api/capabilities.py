"""What the service can do and what it accepts."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any, get_args

from fastapi import APIRouter
from starlette.responses import Response

from ..schemas.session import Limits, Preset
from ..service import Service
from ..snapshot_signer import READABLE
from . import contract
from .answers import answer
from .deps import Accepted, Caller, ServiceDep

PROTOCOL_VERSION = 1
SUBPROTOCOLS = ["mfcmt.v1.json", "mfcmt.v1.msgpack"]
IMAGE_TYPES = ["image/jpeg", "image/png", "image/webp"]

router = APIRouter(tags=["service"])


@router.get("/capabilities", **contract.CAPABILITIES)
async def get_capabilities(service: ServiceDep, caller: Caller, accepted: Accepted) -> Response:  # noqa: ARG001
    """Limits, presets, image types, versions."""
    return answer(accepted, 200, capabilities(service))


def capabilities(service: Service) -> dict[str, Any]:
    """The Capabilities of the protocol."""
    limits = {name: getattr(service.settings, name) for name in Limits.model_fields}
    shares = service.registry.shares
    limits |= {"max_sessions_per_key": shares.sessions, "max_streams_per_key": shares.streams}
    lanes = next((status.versions for status in service.lanes.status() if status.versions), {})
    return {
        "protocol": PROTOCOL_VERSION,
        "subprotocols": SUBPROTOCOLS,
        "modes": ["latest", "lossless"],
        "presets": list(get_args(Preset)),
        "image_types": IMAGE_TYPES,
        "trajectory_formats": ["json", "csv", "otb", "mot"],
        "snapshot_versions": list(READABLE),
        "limits": limits,
        "software": {"mfcmt": version("mfcmt")} | lanes,
    }
