"""Probes of health and readiness, and the metrics."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from ..protocol import examples
from ..protocol.answers import message
from ..protocol.capabilities import Health
from ..protocol.enums import HealthStatus, ProblemCode
from ..protocol.problems import NO_LANE, ProblemError
from ..service import Service
from . import contract
from .answers import JSON, MAX_ACCEPT_CHARACTERS, encode
from .deps import ServiceDep

router = APIRouter(tags=["service"])


@router.get(
    "/livez",
    response_model=Health,
    response_description="the process answers",
    responses=contract.problems(*contract.ANY_PATH),
)
async def livez(service: ServiceDep) -> Response:
    """Answer as long as the process lives."""
    return encode(JSON, _health(service) | {"status": HealthStatus.OK})


@router.get(
    "/readyz",
    response_model=Health,
    response_description="new sessions are welcome",
    responses=contract.problems(*contract.ANY_PATH, "at-capacity", "draining"),
)
async def readyz(service: ServiceDep) -> Response:
    """Answer with 200 while new sessions are welcome."""
    health = _health(service)
    code, detail = _NOT_READY.get(health["status"], (None, ""))
    if code is not None:
        raise ProblemError(code, detail, retry_after_s=1.0, lanes_ready=health["lanes_ready"], lanes=health["lanes"])
    return encode(JSON, health)


@router.get(
    "/metrics",
    responses={
        200: {
            "description": "the metrics",
            "content": contract.contents(
                "text/plain",
                "application/openmetrics-text",
                schema={"type": "string"},
                example=examples.METRICS,
            ),
        },
        **contract.problems(*contract.ANY_PATH, "unauthenticated"),
    },
    response_class=Response,
)
async def metrics(request: Request, service: ServiceDep) -> Response:
    """Give the metrics in Prometheus' text format."""
    service.authenticator.check_admin(request.headers)
    text, media_type = await service.exporter.text(request.headers.get("accept", "")[:MAX_ACCEPT_CHARACTERS])
    return Response(text, headers={"Content-Type": media_type})


_NOT_READY = {
    HealthStatus.DRAINING: (ProblemCode.DRAINING, "the service is shutting down"),
    HealthStatus.FAILING: (ProblemCode.AT_CAPACITY, "lanes die again and again"),
    HealthStatus.STARTING: (ProblemCode.AT_CAPACITY, NO_LANE),
}


def _health(service: Service) -> dict[str, Any]:
    lanes = service.lanes.status()
    ready = sum(status.ready for status in lanes)
    status = HealthStatus.OK
    if service.registry.draining:
        status = HealthStatus.DRAINING
    elif not ready:
        status = HealthStatus.FAILING if any(lane.failing for lane in lanes) else HealthStatus.STARTING
    return message(Health, status=status, lanes_ready=ready, lanes=len(lanes))
