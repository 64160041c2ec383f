"""The OpenAPI document: FastAPI's view of the calls, with the schemas of ours."""

from __future__ import annotations

import json
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
from . import contract

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
SECURITY = {
    "bearer": {"type": "http", "scheme": "bearer"},
    "apiKey": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
}
DESCRIPTION = "Visual object tracking: a session starts with a frame and a box; every later frame says where it is."


def schemas(settings: Settings) -> dict[str, Any]:
    """Every schema that the document refers to, with the limits of this service."""
    _, told = models_json_schema([(model, "validation") for model in MODELS], ref_template=REF)
    defined: dict[str, Any] = told["$defs"]
    for name, kind in NAMED.items():
        defined[name] = TypeAdapter(kind).json_schema(ref_template=REF)
    defined |= contract.BODIES
    for name in ("Options", "TicketBody"):
        _leave_out(defined[name])
    defined["TicketBody"]["properties"]["ttl_s"]["anyOf"][0]["maximum"] = settings.max_ticket_s
    defined["Options"]["properties"]["idle_timeout_s"]["anyOf"][0]["maximum"] = settings.max_idle_timeout_s
    return defined


def _leave_out(schema: dict[str, Any]) -> None:
    """Tell defaults in words: what has one in the schema is demanded of the caller by generated types."""
    for told in schema["properties"].values():
        default = told.pop("default", None)
        if default is not None:
            told["description"] = f"{told.get('description', '')} (default: {json.dumps(default)})".lstrip()


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
    keyed = {
        path: calls
        for path, calls in told["paths"].items()
        if (settings.authenticated and path.startswith("/v1/")) or (settings.admin_key and path == "/metrics")
    }
    if keyed:
        components["securitySchemes"] = SECURITY
    for calls in keyed.values():
        for call in calls.values():
            call["security"] = [{name: []} for name in SECURITY]
    return told


def _restore(call: dict[str, Any], route: APIRoute) -> None:
    """A plain name, and answers and body as we wrote them.

    FastAPI makes names of paths, adds an error of its own and drops every null of an example.
    """
    call["operationId"] = route.name
    call["responses"] = {str(status): answer for status, answer in route.responses.items()}
    if body := (route.openapi_extra or {}).get("requestBody"):
        call["requestBody"] = body
