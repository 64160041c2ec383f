"""The OpenAPI document: FastAPI's view of the calls, with the schemas of ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import TypeAdapter
from pydantic.json_schema import models_json_schema

from ..schemas import session as shapes
from ..settings import Settings

REF = "#/components/schemas/{model}"
MODELS = (
    shapes.Session,
    shapes.SessionPage,
    shapes.Result,
    shapes.TargetAnswer,
    shapes.TicketBody,
    shapes.TicketAnswer,
    shapes.TrajectoryAnswer,
    shapes.Capabilities,
    shapes.Health,
    shapes.Problem,
    shapes.Options,
    shapes.BoxBody,
)
NAMED: dict[str, Any] = {"Box": shapes.Box, "Region": shapes.Region, "Seq": shapes.Seq, "Echo": shapes.Echo}
DESCRIPTION = "Visual object tracking: a session starts with a frame and a box; every later frame says where it is."


def schemas(settings: Settings) -> dict[str, Any]:
    """Every schema that the document refers to, with the limits of this service."""
    _, told = models_json_schema([(model, "validation") for model in MODELS], ref_template=REF)
    defined: dict[str, Any] = told["$defs"]
    for name, kind in NAMED.items():
        defined[name] = TypeAdapter(kind).json_schema(ref_template=REF)
    defined["TicketBody"]["properties"]["ttl_s"]["anyOf"][0]["maximum"] = settings.max_ticket_s
    defined["Options"]["properties"]["idle_timeout_s"]["anyOf"][0]["maximum"] = settings.max_idle_timeout_s
    return defined


def install(app: FastAPI, routers: Mapping[str, Sequence[APIRouter]], settings: Settings) -> None:
    """Make ``app.openapi()`` give the document; ``routers`` are those of the calls, by their prefix."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app, routers, settings)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _document(app: FastAPI, routers: Mapping[str, Sequence[APIRouter]], settings: Settings) -> dict[str, Any]:
    told = get_openapi(title="MFCMT", version=version("mfcmt"), description=DESCRIPTION, routes=app.routes)
    for prefix, some in routers.items():
        for router in some:
            for route in router.routes:
                if isinstance(route, APIRoute) and route.include_in_schema:
                    for method in route.methods or ():
                        _restore(told["paths"][prefix + route.path][method.lower()], route)
    components = told.setdefault("components", {})
    components["schemas"] = schemas(settings)
    if settings.api_keys:
        components["securitySchemes"] = {
            "bearer": {"type": "http", "scheme": "bearer"},
            "apiKey": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
        }
        for path, calls in told["paths"].items():
            for call in calls.values():
                if path.startswith("/v1/"):
                    call["security"] = [{"bearer": []}, {"apiKey": []}]
    return told


def _restore(call: dict[str, Any], route: APIRoute) -> None:
    """Answers and body as we wrote them: FastAPI adds an error of its own and drops every null of an example."""
    call["responses"] = {str(status): answer for status, answer in route.responses.items()}
    if body := (route.openapi_extra or {}).get("requestBody"):
        call["requestBody"] = body
