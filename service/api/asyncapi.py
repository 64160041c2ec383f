"""The AsyncAPI 3 document of the stream, from the same definitions as the OpenAPI document."""

from __future__ import annotations

from collections import defaultdict
from importlib.metadata import version
from typing import Any

from ..protocol import answers, examples, requests
from ..protocol.codecs import CODECS
from ..protocol.enums import CloseCode, Mode
from ..protocol.problems import CLOSE_OF_REFUSAL
from ..protocol.schema import REF, schemas

ASYNCAPI = "3.0.0"
MESSAGES = (*requests.STREAM_MESSAGES, *answers.STREAM_MESSAGES)


def close_codes() -> dict[int, str]:
    """Return every close code of the protocol and what it says."""
    refused: defaultdict[CloseCode, list[str]] = defaultdict(list)
    for problem, code in CLOSE_OF_REFUSAL.items():
        refused[code].append(f"`{problem}`")
    return {code.value: code.meaning or " or ".join(refused[code]) for code in CloseCode}


def document() -> dict[str, Any]:
    """Return the whole document."""
    channel = "#/channels/stream"
    return {
        "asyncapi": ASYNCAPI,
        "info": {
            "title": "MFCMT stream",
            "version": version("mfcmt"),
            "description": "Frames in, results out, over one WebSocket. Subprotocols: "
            + ", ".join(f"`{name}`" for name in CODECS)
            + ". Close codes: "
            + "; ".join(f"{code} {text}" for code, text in close_codes().items())
            + ".",
        },
        "defaultContentType": "application/json",
        "channels": {
            "stream": {
                "address": "/v1/sessions/{session_id}/stream",
                "parameters": {"session_id": {"description": "the session's `id`"}},
                "messages": {m.__name__: {"$ref": f"#/components/messages/{m.__name__}"} for m in MESSAGES},
                "bindings": {"ws": {"query": _QUERY}},
            }
        },
        "operations": {
            "send": {
                "action": "receive",
                "title": "what a client sends",
                "channel": {"$ref": channel},
                "messages": [{"$ref": f"{channel}/messages/{m.__name__}"} for m in requests.STREAM_MESSAGES],
            },
            "receive": {
                "action": "send",
                "title": "what the service sends",
                "channel": {"$ref": channel},
                "messages": [{"$ref": f"{channel}/messages/{m.__name__}"} for m in answers.STREAM_MESSAGES],
            },
        },
        "components": {
            "messages": {m.__name__: _message(m) for m in MESSAGES},
            "schemas": schemas(MESSAGES),
        },
    }


def _message(kind: type) -> dict[str, Any]:
    name = kind.__name__
    return {
        "name": name,
        "summary": (kind.__doc__ or "").strip().splitlines()[0],
        "payload": {"$ref": REF.format(model=name)},
        "examples": [{"payload": example} for example in examples.STREAM[name]],
    }


_QUERY = {
    "type": "object",
    "properties": {
        "mode": {"type": "string", "enum": list(Mode), "default": Mode.LATEST},
        "takeover": {"type": "string", "enum": ["true", "false"], "default": "false"},
        "resume": {"type": "string", "description": "`attachment` of the `ready` that is to be replaced"},
    },
}
