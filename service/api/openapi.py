"""The OpenAPI document: FastAPI's view of the calls, with the schemas of ours."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import TypeAdapter
from pydantic.json_schema import models_json_schema

from ..schemas import session as shapes

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


def schemas() -> dict[str, Any]:
    """Every schema that both contracts refer to."""
    _, told = models_json_schema([(model, "validation") for model in MODELS], ref_template=REF)
    defined: dict[str, Any] = told["$defs"]
    for name, kind in NAMED.items():
        defined[name] = TypeAdapter(kind).json_schema(ref_template=REF)
    return defined


def install(app: FastAPI, *, authenticated: bool) -> None:
    """Make ``app.openapi()`` give the document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app, authenticated)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _document(app: FastAPI, authenticated: bool) -> dict[str, Any]:
    told = get_openapi(title="MFCMT", version=version("mfcmt"), description=DESCRIPTION, routes=app.routes)
    components = told.setdefault("components", {})
    components["schemas"] = schemas()
    for path, calls in told["paths"].items():
        for call in calls.values():
            # FastAPI documents a validation error of its own; here such a call is a bad-request.
            if not any("problem" in media for media in call["responses"].get("422", {}).get("content", {})):
                call["responses"].pop("422", None)
            if authenticated and path.startswith("/v1/"):
                call["security"] = [{"bearer": []}, {"apiKey": []}]
    if authenticated:
        components["securitySchemes"] = {
            "bearer": {"type": "http", "scheme": "bearer"},
            "apiKey": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
        }
    return told
