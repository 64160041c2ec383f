"""The parts of the OpenAPI document that FastAPI cannot see: refusals and request bodies."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from pydantic import TypeAdapter

from ..protocol import examples
from ..protocol.enums import ProblemCode
from ..protocol.problems import CATALOGUE, MEDIA_TYPE
from ..protocol.schema import REF, name_of
from ..protocol.values import BOX_DOC, Box
from .answers import BYTES, FORM, JSON, MSGPACK, SNAPSHOT

# The codes that calls of a kind can answer with. Probes, too, can answer with those of every path.
ANY_PATH = ("host-refused", "origin-refused", "internal")
ANY_CALL = (*ANY_PATH, "unauthenticated", "rate-limited", "at-capacity")
READS_BODY = ("bad-request", "body-too-large", "unsupported-media-type", "deadline-exceeded")
READS_FRAME = (*READS_BODY, "frame-too-large", "unsupported-image", "frame-undecodable")
ON_SESSION = ("session-not-found", "session-gone", "elsewhere")
IN_LANE = ("deadline-exceeded",)
NEGOTIATED = ("not-acceptable",)
WITH_BOX = (*ANY_CALL, *READS_BODY, *NEGOTIATED, *ON_SESSION, "bad-box", "full-frame-needed")

RETRY_AFTER = {"Retry-After": {"description": "seconds", "schema": {"type": "integer", "minimum": 1}}}
BINARY = {"type": "string", "format": "binary"}
IMAGE = BINARY | {"description": "JPEG, PNG or WebP"}
_ENCODED = {"type": "string", "format": "byte", "description": "the image in base64"}
_BIN = BINARY | {"description": "the image; bin"}
_IMAGE_PART = {"contentType": "image/jpeg, image/png, image/webp"}
_IN_FORM = "(the image)"


def ref(name: str) -> dict[str, str]:
    """Return a reference to a schema."""
    return {"$ref": REF.format(model=name)}


def problems(*codes: str) -> dict[int | str, dict[str, Any]]:
    """Return the responses of a call that can refuse with ``codes``, by status."""
    by_status: defaultdict[int, list[ProblemCode]] = defaultdict(list)
    for code in map(ProblemCode, dict.fromkeys(codes)):
        by_status[CATALOGUE[code].status].append(code)
    return {
        status: {
            "description": "; ".join(f"`{code}`: {CATALOGUE[code].title}" for code in here),
            "content": {
                MEDIA_TYPE: {
                    "schema": ref("Problem"),
                    "examples": {code.value: {"value": examples.problem(code)} for code in here},
                }
            },
            **({"headers": RETRY_AFTER} if status in (429, 503) else {}),
        }
        for status, here in sorted(by_status.items())
    }


def contents(*kinds: str, schema: dict[str, Any], example: Any) -> dict[str, Any]:
    """Return the description of a body that has one schema in several media types."""
    return {kind: {"schema": schema, "example": example} for kind in kinds}


def request(content: dict[str, Any], *, required: bool = True) -> dict[str, Any]:
    """Return the extra entry of a call that reads a body."""
    return {"requestBody": {"required": required, "content": content}}


def body(kind: type, *, required: bool = True) -> dict[str, Any]:
    """Return the extra entry of a call that reads a body of the class ``kind`` in JSON or MessagePack."""
    name = name_of(kind)
    return request(contents(JSON, MSGPACK, schema=ref(name), example=examples.BODIES[name]), required=required)


_FOUR = r"(0|[1-9]\d{0,3}),(0|[1-9]\d{0,3}),[1-9]\d{0,3},[1-9]\d{0,3}"
_BOX_TEXT = {"type": "string", "description": "`x,y,w,h` or a JSON array", "pattern": f"^{_FOUR}$"}
_BOXES_TEXT = {
    "type": "string",
    "description": "a JSON array of boxes",
    "pattern": rf"^\[\[{_FOUR}\](,\[{_FOUR}\]){{0,3}}\]$",
}
# Not a reference: a generated class with two references to one list defines a name twice.
_BOXES = {"type": "array", "items": BOX_DOC | TypeAdapter(Box).json_schema(), "minItems": 1}
# One of the two, in a form from which code generators make one class for the body.
_BOX_OR_BOXES: dict[str, Any] = {
    "if": {"required": ["box"]},
    "then": {"not": {"required": ["boxes"]}},
    "else": {"required": ["boxes"]},
}


def _with_frame(frame: dict[str, Any], properties: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {"frame": frame, **properties},
        "required": ["frame"],
        "additionalProperties": False,
        **more,
    }


_CREATE = {"box": ref("Box"), "boxes": _BOXES, "options": ref("Options")}
_CREATE_TEXT = {"box": _BOX_TEXT, "boxes": _BOXES_TEXT, "options": ref("Options")}
_META = {"seq": ref("Seq"), "ts": ref("Echo"), "region": ref("Region")}
FRAME_BODIES = {
    "CreateBody": _with_frame(_ENCODED, _CREATE, **_BOX_OR_BOXES),
    "CreateForm": _with_frame(IMAGE, _CREATE_TEXT, **_BOX_OR_BOXES),
    "FrameBody": _with_frame(_ENCODED, _META),
    "FrameForm": _with_frame(IMAGE, {}),
}
"""Schemas of the bodies with a frame; generated clients have classes of these names."""

CREATE_BODY = request(
    {
        FORM: {
            "schema": ref("CreateForm"),
            "encoding": {"frame": _IMAGE_PART, "options": {"contentType": JSON}},
            "example": {"frame": _IN_FORM, "box": "198,214,34,81", "options": {"preset": "default"}},
        },
        JSON: {"schema": ref("CreateBody"), "example": examples.CREATE},
        MSGPACK: {"schema": _with_frame(_BIN, _CREATE, **_BOX_OR_BOXES), "example": examples.CREATE},
        **contents(SNAPSHOT, BYTES, schema=BINARY, example="(what /snapshot gave)"),
    }
)
_FRAME_EXAMPLE = {"frame": examples.CREATE["frame"], "seq": 17, "ts": 1712.5}
FRAME_BODY = request(
    {
        **contents("image/jpeg", "image/png", "image/webp", BYTES, schema=IMAGE, example=_IN_FORM),
        FORM: {"schema": ref("FrameForm"), "encoding": {"frame": _IMAGE_PART}, "example": {"frame": _IN_FORM}},
        JSON: {"schema": ref("FrameBody"), "example": _FRAME_EXAMPLE},
        MSGPACK: {"schema": _with_frame(_BIN, _META), "example": _FRAME_EXAMPLE},
    }
)
