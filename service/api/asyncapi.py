"""The AsyncAPI 3 document of the stream, made from the same models as the OpenAPI document."""

from __future__ import annotations

from collections import defaultdict
from importlib.metadata import version
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from ..schemas import examples, messages
from .capabilities import SUBPROTOCOLS
from .stream import CLOSE_CODES

ASYNCAPI = "3.0.0"
REF = "#/components/schemas/{model}"
EXAMPLES: dict[str, list[Any]] = {
    "Meta": [examples.META],
    "FrameMessage": [{"type": "frame", "frame": "(bin)", "seq": 17}],
    "Add": [examples.CONTROLS[0]],
    "Correct": [examples.CONTROLS[1]],
    "Remove": [examples.CONTROLS[2]],
    "Ready": [examples.READY],
    "Result": [examples.RESULT],
    "Error": [examples.ERROR],
    "Targets": [examples.TARGETS],
    "Draining": [examples.DRAINING],
}
# What the server closes with, beside the codes of refused handshakes.
CLOSES = {
    1000: "the session was closed",
    1001: "going away",
    1009: "a message above twice `max_frame_bytes`",
    1011: "a fault of the service, or no pong",
    1012: "the service restarts",
    4400: "an unreadable message or the wrong opcode",
    4408: "the session was idle for too long",
    4409: "attached elsewhere",
    4410: "the session is gone",
    4429: "too many messages",
}


def close_codes() -> dict[int, str]:
    """Every close code of the protocol and what it says."""
    refused: defaultdict[int, list[str]] = defaultdict(list)
    for problem, code in CLOSE_CODES.items():
        refused[code].append(f"`{problem}`")
    return dict(sorted(({code: " or ".join(some) for code, some in refused.items()} | CLOSES).items()))


def document() -> dict[str, Any]:
    """The whole document."""
    models: list[type[BaseModel]] = [*messages.CLIENT, *messages.SERVER]
    _, told = models_json_schema([(model, "validation") for model in models], ref_template=REF)
    channel = "#/channels/stream"
    return {
        "asyncapi": ASYNCAPI,
        "info": {
            "title": "MFCMT stream",
            "version": version("mfcmt"),
            "description": "Frames in, results out, over one WebSocket. Subprotocols: "
            + ", ".join(f"`{name}`" for name in SUBPROTOCOLS)
            + ". Close codes: "
            + "; ".join(f"{code} {text}" for code, text in close_codes().items())
            + ".",
        },
        "defaultContentType": "application/json",
        "channels": {
            "stream": {
                "address": "/v1/sessions/{session_id}/stream",
                "parameters": {"session_id": {"description": "the session's `id`"}},
                "messages": {m.__name__: {"$ref": f"#/components/messages/{m.__name__}"} for m in models},
                "bindings": {"ws": {"query": _QUERY}},
            }
        },
        "operations": {
            "send": {
                "action": "receive",
                "title": "what a client sends",
                "channel": {"$ref": channel},
                "messages": [{"$ref": f"{channel}/messages/{m.__name__}"} for m in messages.CLIENT],
            },
            "receive": {
                "action": "send",
                "title": "what the service sends",
                "channel": {"$ref": channel},
                "messages": [{"$ref": f"{channel}/messages/{m.__name__}"} for m in messages.SERVER],
            },
        },
        "components": {
            "messages": {m.__name__: _message(m) for m in models},
            "schemas": told["$defs"],
        },
    }


def _message(model: type[BaseModel]) -> dict[str, Any]:
    name = model.__name__
    return {
        "name": name,
        "summary": (model.__doc__ or "").strip().splitlines()[0],
        "payload": {"$ref": REF.format(model=name)},
        "examples": [{"payload": example} for example in EXAMPLES[name]],
    }


_QUERY = {
    "type": "object",
    "properties": {
        "mode": {"type": "string", "enum": ["latest", "lossless"], "default": "latest"},
        "takeover": {"type": "string", "enum": ["true", "false"], "default": "false"},
        "resume": {"type": "string", "description": "`attachment` of the `ready` that is to be replaced"},
    },
}
