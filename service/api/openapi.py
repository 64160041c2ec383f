"""The OpenAPI document: FastAPI's, with the schemas and examples of the protocol."""

from __future__ import annotations

import json
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from ..protocol import examples
from ..protocol.answers import (
    ProblemDocument,
    Result,
    SessionInfo,
    SessionPage,
    TargetChange,
    Ticket,
    Trajectory,
)
from ..protocol.capabilities import Capabilities, Health
from ..protocol.requests import BoxBody, Options, TicketBody
from ..protocol.schema import NAMES, schemas
from ..settings import Settings
from . import contract
from .answers import JSON, MSGPACK

KINDS = (
    SessionInfo,
    SessionPage,
    Result,
    TargetChange,
    TicketBody,
    Ticket,
    Trajectory,
    Capabilities,
    Health,
    ProblemDocument,
    Options,
    BoxBody,
)
SECURITY = {
    "bearer": {"type": "http", "scheme": "bearer"},
    "apiKey": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
}
DESCRIPTION = (
    "Visual object tracking: a frame and a box start a session; every later frame is answered with the target's box."
)
PLAIN_JSON = ("/livez", "/readyz")
"""Calls that answer in JSON alone."""


def install(app: FastAPI, settings: Settings) -> None:
    """Make ``app.openapi()`` return the document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app, settings)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _document(app: FastAPI, settings: Settings) -> dict[str, Any]:
    document = get_openapi(title="MFCMT", version=version("mfcmt"), description=DESCRIPTION, routes=app.routes)
    found = document["components"]["schemas"]
    components: dict[str, Any] = {"schemas": _schemas(settings)}
    document["components"] = components
    secured = set()
    for path, calls in document["paths"].items():
        for call in calls.values():
            _describe_answers(call, path)
            for parameter in call.get("parameters", ()):
                schema = parameter["schema"]
                if named := schema.pop("$ref", None):  # a closed set: in place, as in the other schemas
                    schema |= found[named.rpartition("/")[2]] | {"title": parameter["name"].title()}
                    schema.pop("description", None)
            if (settings.authenticated and path.startswith("/v1/")) or (settings.admin_key and path == "/metrics"):
                call["security"] = [{name: []} for name in SECURITY]
                secured.add(path)
    if secured:
        components["securitySchemes"] = SECURITY
    return document


def _schemas(settings: Settings) -> dict[str, Any]:
    """Return every schema that the document refers to, with the limits of this service."""
    defined = schemas(KINDS) | contract.FRAME_BODIES
    for name in ("Options", "TicketBody"):
        _describe_defaults(defined[name])
    defined["TicketBody"]["properties"]["ttl_s"]["anyOf"][0]["maximum"] = settings.max_ticket_s
    defined["Options"]["properties"]["idle_timeout_s"]["anyOf"][0]["maximum"] = settings.max_idle_timeout_s
    return defined


def _describe_defaults(schema: dict[str, Any]) -> None:
    """Move defaults into the descriptions: generated types demand a field that has one in its schema."""
    for field in schema["properties"].values():
        default = field.pop("default", None)
        if default is not None:
            field["description"] = f"{field.get('description', '')} (default: {json.dumps(default)})".lstrip()


def _describe_answers(call: dict[str, Any], path: str) -> None:
    """Give the call's answers the names, media types and examples of the protocol.

    FastAPI names schemas by their classes, adds an error of its own, and drops every null of an example.
    """
    answers = call["responses"]
    if "HTTPValidationError" in str(answers.get("422")):
        del answers["422"]
    for status, answer in answers.items():
        media = answer.get("content", {}).get(JSON)
        if media is None or not status.startswith("2"):
            continue
        kind = media["schema"]["$ref"].rpartition("/")[2]
        name = NAMES.get(kind, kind)
        kinds = (JSON,) if path in PLAIN_JSON else (JSON, MSGPACK)
        answer["content"] |= contract.contents(*kinds, schema=contract.ref(name), example=examples.ANSWERS[name])
