"""For whoever watches: alive, ready, and the metrics."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from ..problems import NO_LANE, ProblemError
from ..service import Service
from . import contract
from .answers import MAX_ACCEPT_CHARACTERS, answer
from .bodies import JSON
from .deps import ServiceDep

router = APIRouter(tags=["service"])


@router.get("/livez", **contract.LIVEZ)
async def livez(service: ServiceDep) -> Response:
    """The process answers."""
    return answer(JSON, 200, _health(service) | {"status": "ok"})


@router.get("/readyz", **contract.READYZ)
async def readyz(service: ServiceDep) -> Response:
    """New sessions are welcome."""
    health = _health(service)
    if health["status"] == "draining":
        raise ProblemError("draining", "the service is going away", retry_after_s=1.0, **_lanes(health))
    if health["status"] == "failing":
        raise ProblemError("at-capacity", "lanes die again and again", retry_after_s=1.0, **_lanes(health))
    if health["status"] == "starting":
        raise ProblemError("at-capacity", NO_LANE, retry_after_s=1.0, **_lanes(health))
    return answer(JSON, 200, health)


@router.get("/metrics", **contract.METRICS)
async def metrics(request: Request, service: ServiceDep) -> Response:
    """Prometheus' text format."""
    service.gate.check_admin(request.headers)
    text, media_type = await service.exposition.text(request.headers.get("accept", "")[:MAX_ACCEPT_CHARACTERS])
    return Response(text, headers={"Content-Type": media_type})


def _health(service: Service) -> dict[str, Any]:
    lanes = service.lanes.status()
    ready = sum(status.ready for status in lanes)
    status = "ok"
    if not ready:
        status = "failing" if any(lane.failing for lane in lanes) else "starting"
    if service.registry.draining:
        status = "draining"
    return {"status": status, "lanes_ready": ready, "lanes": len(lanes)}


def _lanes(health: dict[str, Any]) -> dict[str, int]:
    return {"lanes_ready": health["lanes_ready"], "lanes": health["lanes"]}
