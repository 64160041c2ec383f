"""What each call's entry in the OpenAPI document says beyond its parameters."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from pydantic import TypeAdapter

from ..problems import CATALOGUE, MEDIA_TYPE
from ..schemas import examples
from ..schemas.session import Box
from .bodies import BYTES, FORM, JSON, MSGPACK
from .bodies import SNAPSHOT as SNAPSHOT_TYPE

# What every path can answer, the probes too.
ANY_PATH = ("host-refused", "origin-refused", "internal")
ANY_CALL = (*ANY_PATH, "unauthenticated", "rate-limited", "at-capacity")
WITH_BODY = ("bad-request", "body-too-large", "unsupported-media-type", "deadline-exceeded")
ON_SESSION = ("session-not-found", "session-gone")
IN_LANE = ("deadline-exceeded",)
NEGOTIATED = ("not-acceptable",)
RETRY_AFTER = {"Retry-After": {"description": "seconds", "schema": {"type": "integer", "minimum": 1}}}
BINARY = {"type": "string", "format": "binary"}
IMAGE = {"type": "string", "format": "binary", "description": "JPEG, PNG or WebP"}
KEY = {
    "name": "Idempotency-Key",
    "in": "header",
    "required": False,
    "description": "the same key and body within ten minutes answers with the same session",
    "schema": {"type": "string", "minLength": 1, "maxLength": 255, "pattern": "^[!-~]+$"},
}


def ref(name: str) -> dict[str, str]:
    """A reference to a schema."""
    return {"$ref": f"#/components/schemas/{name}"}


def problems(*codes: str) -> dict[int, dict[str, Any]]:
    """The responses of ``codes``, by status."""
    by_status: defaultdict[int, list[str]] = defaultdict(list)
    for code in dict.fromkeys(codes):
        by_status[CATALOGUE[code].status].append(code)
    return {
        status: {
            "description": "; ".join(f"`{code}`: {CATALOGUE[code].title}" for code in here),
            "content": {
                MEDIA_TYPE: {
                    "schema": ref("Problem"),
                    "examples": {code: {"value": examples.problem(code)} for code in here},
                }
            },
            **({"headers": RETRY_AFTER} if status in (429, 503) else {}),
        }
        for status, here in sorted(by_status.items())
    }


def content(schema: str, example: Any) -> dict[str, Any]:
    """An answer in JSON or MessagePack."""
    media = {"schema": ref(schema), "example": example}
    return {JSON: media, MSGPACK: media}


def _call(
    status: int, told: dict[str, Any], *codes: str, body: dict[str, Any] | None = None, **more: Any
) -> dict[str, Any]:
    extra = dict(more)
    if body is not None:
        extra["requestBody"] = {"required": True, "content": body}
    return {"responses": {status: told, **problems(*codes)}, "openapi_extra": extra}


def _session_answer(description: str) -> dict[str, Any]:
    return {"description": description, "content": content("Session", examples.SESSION)}


_FOUR = r"(0|[1-9]\d{0,3}),(0|[1-9]\d{0,3}),[1-9]\d{0,3},[1-9]\d{0,3}"
_BOX_TEXT = {"type": "string", "description": "`x,y,w,h` or a JSON array", "pattern": f"^{_FOUR}$"}
_BOXES_TEXT = {
    "type": "string",
    "description": "a JSON array of boxes",
    "pattern": rf"^\[\[{_FOUR}\](,\[{_FOUR}\]){{0,3}}\]$",
}
_ENCODED = {"type": "string", "format": "byte", "description": "the image in base64"}
_BINARY = {"type": "string", "format": "binary", "description": "the image; bin"}
_IMAGE_PART = {"contentType": "image/jpeg, image/png, image/webp"}
# Not by reference: a generated class with two references to one list defines a name twice.
_BOXES = {"type": "array", "items": TypeAdapter(Box).json_schema(), "minItems": 1}
# One of the two. Said so that what makes code of schemas has one class for the body.
_BOX_OR_BOXES: dict[str, Any] = {
    "if": {"required": ["box"]},
    "then": {"not": {"required": ["boxes"]}},
    "else": {"required": ["boxes"]},
}


def _map(properties: dict[str, Any], **more: Any) -> dict[str, Any]:
    """The schema of a map with a frame."""
    return {
        "type": "object",
        "properties": properties,
        "required": ["frame"],
        "additionalProperties": False,
        **more,
    }


def _create(frame: dict[str, Any]) -> dict[str, Any]:
    properties = {"frame": frame, "box": ref("Box"), "boxes": _BOXES, "options": ref("Options")}
    return _map(properties, **_BOX_OR_BOXES)


def _frame(frame: dict[str, Any]) -> dict[str, Any]:
    return _map({"frame": frame, "seq": ref("Seq"), "ts": ref("Echo"), "region": ref("Region")})


# The bodies with a frame, by the names that their classes get in generated clients.
BODIES = {
    "CreateBody": _create(_ENCODED),
    "CreateForm": _map(
        {"frame": IMAGE, "box": _BOX_TEXT, "boxes": _BOXES_TEXT, "options": ref("Options")}, **_BOX_OR_BOXES
    ),
    "FrameBody": _frame(_ENCODED),
    "FrameForm": _map({"frame": IMAGE}),
}
_CREATE_FORM = {
    "schema": ref("CreateForm"),
    "encoding": {"frame": _IMAGE_PART, "options": {"contentType": JSON}},
    "example": {"frame": "(the image)", "box": "198,214,34,81", "options": {"preset": "default"}},
}
_FRAME_EXAMPLE = {"frame": examples.CREATE["frame"], "seq": 17, "ts": 1712.5}
_FRAME_FORM = {
    "schema": ref("FrameForm"),
    "encoding": {"frame": _IMAGE_PART},
    "example": {"frame": "(the image)"},
}
_SNAPSHOT = {"schema": BINARY, "example": "(what /snapshot gave)"}

CREATE_SESSION = _call(
    201,
    _session_answer("the session, with its first frame tracked")
    | {"headers": {"Location": {"description": "the session", "schema": {"type": "string"}}}},
    *ANY_CALL,
    *WITH_BODY,
    *NEGOTIATED,
    "frame-too-large",
    "unsupported-image",
    "frame-undecodable",
    "bad-box",
    "bad-snapshot",
    "too-many-targets",
    "over-quota",
    "draining",
    "session-gone",  # of a repeated Idempotency-Key
    body={
        FORM: _CREATE_FORM,
        JSON: {"schema": ref("CreateBody"), "example": examples.CREATE},
        MSGPACK: {"schema": _create(_BINARY), "example": examples.CREATE},
        SNAPSHOT_TYPE: _SNAPSHOT,
        BYTES: _SNAPSHOT,
    },
    parameters=[KEY],
)
LIST_SESSIONS = _call(
    200,
    {"description": "a page of sessions", "content": content("SessionPage", examples.PAGE)},
    *ANY_CALL,
    *NEGOTIATED,
    "bad-request",
)
GET_SESSION = _call(200, _session_answer("the session"), *ANY_CALL, *NEGOTIATED, *ON_SESSION)
DELETE_SESSION = _call(204, {"description": "ended"}, *ANY_CALL, "session-not-found")
_RAW_FRAME = {"schema": IMAGE, "example": "(the image)"}
POST_FRAME = _call(
    200,
    {"description": "where the targets are", "content": content("Result", examples.RESULT)},
    *ANY_CALL,
    *WITH_BODY,
    *NEGOTIATED,
    *ON_SESSION,
    "attached-elsewhere",
    "stale-frame",
    "frame-too-large",
    "unsupported-image",
    "frame-undecodable",
    "frame-size-changed",
    "bad-region",
    "over-credit",
    body={
        "image/jpeg": _RAW_FRAME,
        "image/png": _RAW_FRAME,
        "image/webp": _RAW_FRAME,
        BYTES: _RAW_FRAME,
        FORM: _FRAME_FORM,
        JSON: {"schema": ref("FrameBody"), "example": _FRAME_EXAMPLE},
        MSGPACK: {"schema": _frame(_BINARY), "example": _FRAME_EXAMPLE},
    },
)
_BOX_BODY = {"schema": ref("BoxBody"), "example": {"box": examples.BOX}}
_BOX_PROBLEMS = (*ANY_CALL, *WITH_BODY, *NEGOTIATED, *ON_SESSION, "bad-box", "full-frame-needed")
_TARGET_ANSWER = {"content": content("TargetAnswer", examples.TARGET_ANSWER)}
ADD_TARGET = _call(
    201,
    {"description": "started on the newest frame", **_TARGET_ANSWER},
    *_BOX_PROBLEMS,
    "too-many-targets",
    body={JSON: _BOX_BODY, MSGPACK: _BOX_BODY},
)
CORRECT_TARGET = _call(
    200,
    {"description": "started anew on the newest frame", **_TARGET_ANSWER},
    *_BOX_PROBLEMS,
    "target-not-found",
    body={JSON: _BOX_BODY, MSGPACK: _BOX_BODY},
)
REMOVE_TARGET = _call(
    204, {"description": "removed"}, *ANY_CALL, *ON_SESSION, *IN_LANE, "bad-request", "target-not-found"
)
TRAJECTORY = _call(
    200,
    {
        "description": "tracked frames by rising `seq`, streamed",
        "content": content("TrajectoryAnswer", examples.TRAJECTORY)
        | {
            "text/csv": {"schema": {"type": "string"}, "example": examples.TRAJECTORY_TEXT["csv"]},
            "text/plain": {
                "schema": {"type": "string"},
                "examples": {name: {"value": examples.TRAJECTORY_TEXT[name]} for name in ("otb", "mot")},
            },
        },
    },
    *ANY_CALL,
    *NEGOTIATED,
    *ON_SESSION,
    "bad-request",
)
SNAPSHOT = _call(
    200,
    {
        "description": "the session",
        "content": {kind: {"schema": BINARY, "example": "(signed bytes)"} for kind in (SNAPSHOT_TYPE, BYTES)},
    },
    *ANY_CALL,
    *NEGOTIATED,
    *ON_SESSION,
    *IN_LANE,
)
_TICKET_BODY = {"schema": ref("TicketBody"), "example": {"ttl_s": 30}}
TICKET = _call(
    201,
    {"description": "one handshake", "content": content("TicketAnswer", examples.TICKET)},
    *ANY_CALL,
    *WITH_BODY,
    *NEGOTIATED,
    *ON_SESSION,
    requestBody={"required": False, "content": {JSON: _TICKET_BODY, MSGPACK: _TICKET_BODY}},
)
CAPABILITIES = _call(
    200,
    {"description": "what this service can do", "content": content("Capabilities", examples.CAPABILITIES)},
    *ANY_CALL,
    *NEGOTIATED,
)
_HEALTH = {"content": {JSON: {"schema": ref("Health"), "example": examples.HEALTH}}}
LIVEZ = _call(200, {"description": "the process answers", **_HEALTH}, *ANY_PATH)
READYZ = _call(
    200,
    {"description": "new sessions are welcome", **_HEALTH},
    *ANY_PATH,
    "at-capacity",
    "draining",
)
METRICS = _call(
    200,
    {
        "description": "the metrics",
        "content": {
            kind: {"schema": {"type": "string"}, "example": examples.METRICS}
            for kind in ("text/plain", "application/openmetrics-text")
        },
    },
    *ANY_PATH,
    "unauthenticated",
)
