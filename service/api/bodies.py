"""Bodies as they come in: read within a bound and a time, told by their media type, checked by code."""

from __future__ import annotations

import asyncio
import base64
import binascii
import contextlib
from collections.abc import AsyncGenerator, AsyncIterator
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect, Request

from ..problems import ProblemError
from ..schemas import fields
from ..schemas.packed import Unreadable, from_json, from_msgpack
from ..sessions.byte_budget import Reservation
from ..settings import Settings

JSON, MSGPACK, FORM = "application/json", "application/msgpack", "multipart/form-data"
SNAPSHOT, BYTES = "application/vnd.mfcmt.snapshot", "application/octet-stream"
CURLS_OWN = "application/x-www-form-urlencoded"
FORM_CALL = "curl -F frame=@frame.jpg -F box=x,y,w,h"
EMPTY_SESSION = f"the body is empty; it is the first frame and a box, as with {FORM_CALL}"
EMPTY_FRAME = "the body is empty; it is a JPEG, PNG or WebP image"
FORM_FIELDS = ("box", "boxes", "options")
# Beside the frame: boxes, options, the part headers of a form.
ENVELOPE_BYTES = 64 * 1024
LARGE_BYTES = 4 * 1024 * 1024
# In the state of a scope: what the call holds of the room until it is answered.
HELD = "mfcmt.held"
MAX_TYPE_CHARACTERS = 256
M = TypeVar("M", bound=BaseModel)


@dataclass(slots=True)
class Upload:
    """A body with a frame: the image and the other fields."""

    frame: bytes
    fields: dict[str, Any]


def media_type(request: Request) -> str:
    """The body's media type, without parameters. Raises unsupported-media-type for a very long one."""
    told = request.headers.get("content-type", "")
    if len(told) > MAX_TYPE_CHARACTERS:
        raise ProblemError("unsupported-media-type", f"Content-Type has at most {MAX_TYPE_CHARACTERS} characters")
    return told.partition(";")[0].strip().lower()


async def read(request: Request, limit: int, settings: Settings, code: str = "body-too-large") -> bytes:
    """The whole body. Raises ``code`` above ``limit`` bytes, deadline-exceeded, bad-request."""
    first, more = b"", bytearray()
    async with _in_time(settings):
        async for part in _bounded(request, limit, code):
            if not first:
                first = part
            else:
                more += part if more else first + part
    if not more:
        return first
    # A copy of many megabytes is not made on the event loop.
    return bytes(more) if len(more) < LARGE_BYTES else await asyncio.to_thread(bytes, more)


async def read_map(request: Request, settings: Settings) -> dict[str, Any]:
    """A JSON or MessagePack map; nothing is an empty one."""
    kind = media_type(request)
    data = await read(request, settings.max_body_bytes, settings)
    if not data:
        return {}
    if kind not in (JSON, MSGPACK):
        raise unsupported(JSON, MSGPACK)
    return _map(kind, data)


async def read_upload(request: Request, settings: Settings, *, raw: bool) -> Upload:
    """A frame and its fields; with ``raw`` the body may be the image itself."""
    kind = media_type(request)
    if _empty(request):
        raise ProblemError("unsupported-image" if raw else "bad-request", EMPTY_FRAME if raw else EMPTY_SESSION)
    if kind == FORM:
        return await _form(request, settings)
    if kind == JSON:
        limit = settings.max_json_frame_bytes * 4 // 3 + ENVELOPE_BYTES
        told = _map(kind, await read(request, limit, settings, "frame-too-large"))
        return Upload(_from_base64(told.pop("frame", None), settings), told)
    if kind == MSGPACK:
        limit = settings.max_frame_bytes + ENVELOPE_BYTES
        told = _map(kind, await read(request, limit, settings, "frame-too-large"))
        frame = told.pop("frame", None)
        if type(frame) is not bytes:
            raise ProblemError("bad-request", f"frame {_missing(frame)}the image's bytes (bin)")
        return Upload(_sized(frame, settings), told)
    if raw and (kind.startswith("image/") or kind in (BYTES, "")):
        image = await read(request, settings.max_frame_bytes, settings, "frame-too-large")
        if not image:
            raise ProblemError("unsupported-image", EMPTY_FRAME)
        return Upload(image, {})
    if kind.startswith("image/"):
        raise ProblemError("unsupported-media-type", f"the image goes into a form beside its box: {FORM_CALL}")
    known = (FORM, JSON, MSGPACK, *(("image/*", BYTES) if raw else (SNAPSHOT,)))
    if kind == CURLS_OWN:
        how = "-H 'Content-Type: image/jpeg' --data-binary @frame.jpg" if raw else FORM_CALL
        raise ProblemError("unsupported-media-type", f"{CURLS_OWN} is curl's own; say {how} (read: {', '.join(known)})")
    raise unsupported(*known)


def boxes(told: dict[str, Any]) -> list[list[float]]:
    """``box`` or ``boxes``. Raises bad-request, bad-box."""
    if ("box" in told) == ("boxes" in told):
        both = "both are" if "box" in told else "none is"
        raise ProblemError("bad-request", f"one of box (x, y, w, h) and boxes (a list of such) is needed; {both} given")
    given = [told.pop("box")] if "box" in told else told.pop("boxes")
    if type(given) is not list or not given:
        raise ProblemError("bad-request", "boxes is a list of boxes, [[x, y, w, h], ...]; for one there is box")
    return [fields.box(box) for box in given]


def checked(model: type[M], told: Any) -> M:
    """``told`` as ``model``. Raises bad-request, which names the field and never repeats the value."""
    try:
        return model.model_validate(told)
    except ValidationError as wrong:
        first = wrong.errors(include_input=False, include_url=False, include_context=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"]) or "body"
        raise ProblemError("bad-request", f"{place}: {first['msg']}") from None


def nothing_more(told: dict[str, Any], *known: str) -> None:
    """Raises bad-request for a field that is none of ``known``; those have been taken out."""
    if told:
        raise ProblemError("bad-request", f"unknown field {next(iter(told))[:40]!r}; there are {', '.join(known)}")


def unsupported(*known: str) -> ProblemError:
    """The body's media type is none of ``known``."""
    return ProblemError("unsupported-media-type", f"Content-Type is one of {', '.join(known)}")


def _empty(request: Request) -> bool:
    """Whether the head says that no body follows."""
    return request.headers.get("content-length", "0") == "0" and "transfer-encoding" not in request.headers


def _missing(frame: Any) -> str:
    return "is missing; it is " if frame is None else "is "


@contextlib.asynccontextmanager
async def _in_time(settings: Settings) -> AsyncIterator[None]:
    try:
        async with asyncio.timeout(settings.body_timeout_s):
            yield
    except TimeoutError as slow:
        raise ProblemError("deadline-exceeded", "the body took too long") from slow
    except ClientDisconnect as gone:
        raise ProblemError("bad-request", "the body ended early") from gone


async def _bounded(request: Request, limit: int, code: str) -> AsyncGenerator[bytes, None]:
    too_large = ProblemError(code, f"at most {limit} bytes")
    length = request.headers.get("content-length", "0")
    if length.isdecimal() and int(length[:20]) > limit:
        raise too_large
    share: Reservation = request.scope["state"][HELD]
    read_bytes = 0
    async for part in request.stream():
        share.grow(len(part))
        read_bytes += len(part)
        if read_bytes > limit:
            raise too_large
        if part:
            yield part


def _map(kind: str, data: bytes) -> dict[str, Any]:
    try:
        told = from_json(data) if kind == JSON else from_msgpack(data)
    except Unreadable as unreadable:
        raise ProblemError("bad-request", str(unreadable)) from unreadable
    if not isinstance(told, dict):
        raise ProblemError("bad-request", "the body is a map of named fields")
    return told


async def _form(request: Request, settings: Settings) -> Upload:
    class Parser(MultiPartParser):
        spool_max_size = settings.max_frame_bytes + ENVELOPE_BYTES  # frames never touch a disk

    body = _bounded(request, settings.max_frame_bytes + ENVELOPE_BYTES, "frame-too-large")
    parser = Parser(request.headers, body, max_files=1, max_fields=8, max_part_size=ENVELOPE_BYTES)
    try:
        async with _in_time(settings), contextlib.aclosing(body):
            form = await parser.parse()
    except MultiPartException as broken:
        why = "more than one file, where only frame is one" if "Too many files" in broken.message else broken.message
        raise ProblemError("bad-request", f"the form cannot be read: {why.rstrip('.')}") from broken
    except (KeyError, ValueError) as broken:
        raise ProblemError("bad-request", "the form cannot be read: it is not multipart/form-data") from broken
    told: dict[str, Any] = {}
    frame: bytes | None = None
    for name, value in form.multi_items():
        if name in told or (name == "frame" and frame is not None):
            raise ProblemError("bad-request", f"{name[:40]} is given twice")
        if name == "frame" and isinstance(value, UploadFile):
            frame = await value.read()
            await value.close()
        elif isinstance(value, str):
            told[name] = _form_field(name, value)
        elif name in FORM_FIELDS:
            raise ProblemError("bad-request", f"{name} is a field of text, not a file; the image goes into frame")
        else:
            raise ProblemError("bad-request", f"the image goes into the field frame, not {name[:40]}")
    if frame is None:
        if "frame" in told:
            raise ProblemError("bad-request", "frame is a text, not a file; with curl it is -F frame=@frame.jpg")
        raise ProblemError("bad-request", "the image is missing: it is a file in the field frame")
    return Upload(_sized(frame, settings), told)


def _form_field(name: str, text: str) -> Any:
    if name == "box" and not text.lstrip().startswith("["):
        return numbers(name, text)
    if name in ("box", "boxes", "options"):
        try:
            return from_json(text)
        except Unreadable as unreadable:
            raise ProblemError("bad-request", f"{name}: {unreadable}") from unreadable
    return text


def numbers(name: str, text: str) -> list[float]:
    """``x,y,w,h`` as it stands in a form or a query."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ProblemError("bad-request", f"{name} is four numbers with commas between, x,y,w,h") from None


def _from_base64(text: Any, settings: Settings) -> bytes:
    if not isinstance(text, str):
        raise ProblemError("bad-request", f"frame {_missing(text)}the image in base64")
    if text.startswith("data:"):
        raise ProblemError("bad-request", "frame is the base64 alone: leave out all to the comma (data:...;base64,)")
    if len(text) * 3 // 4 > settings.max_json_frame_bytes + 2:
        raise ProblemError("frame-too-large", f"at most {settings.max_json_frame_bytes} bytes in JSON")
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        broken = " without line breaks" if "\n" in text else ""
        raise ProblemError("bad-request", f"frame is the image in base64{broken}") from None


def _sized(frame: bytes, settings: Settings) -> bytes:
    if len(frame) > settings.max_frame_bytes:
        raise ProblemError("frame-too-large", f"{len(frame)} bytes; at most {settings.max_frame_bytes}")
    return frame
