"""Bodies that carry a frame: a form, JSON with base64, MessagePack, or the image itself."""

from __future__ import annotations

import base64
import binascii
import contextlib
from dataclasses import dataclass
from typing import Any

from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request

from ..protocol.documents import Unreadable, from_json
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from ..protocol.values import check_box
from ..settings import Settings
from .answers import BYTES, FORM, JSON, MSGPACK, SNAPSHOT, content_type, unsupported
from .bodies import bounded, in_time, parse, read, validated

TOO_LARGE = ProblemCode.FRAME_TOO_LARGE
CURL_DEFAULT = "application/x-www-form-urlencoded"
FORM_CALL = "curl -F frame=@frame.jpg -F box=x,y,w,h"
RAW_CALL = "curl -H 'Content-Type: image/jpeg' --data-binary @frame.jpg"
EMPTY_SESSION = f"the body is empty; send the first frame and a box, as with {FORM_CALL}"
EMPTY_FRAME = "the body is empty; send a JPEG, PNG or WebP image"
FORM_FIELDS = ("box", "boxes", "options")
# Boxes, options and the part headers of a form, beside the frame.
ENVELOPE_BYTES = 64 * 1024


@dataclass(slots=True)
class Upload:
    """A frame and the other fields of its body, unchecked."""

    frame: bytes | memoryview
    fields: dict[str, Any]


@dataclass(slots=True)
class NewSession:
    """The body that creates a session."""

    frame: bytes | memoryview
    boxes: list[list[float]]
    options: Options


def check_new_session(upload: Upload, settings: Settings) -> NewSession:
    """Return the checked body of a call that creates a session. Raises the problems of its fields."""
    sent = upload.fields
    boxes = _boxes(sent)
    if len(boxes) > settings.max_targets_per_session:
        raise ProblemError(ProblemCode.TOO_MANY_TARGETS, f"at most {settings.max_targets_per_session} targets")
    options = validated(Options, sent.pop("options", None) or {})
    refuse_others(sent, "frame", "box", "boxes", "options")
    if options.idle_timeout_s is not None and options.idle_timeout_s > settings.max_idle_timeout_s:
        detail = f"options.idle_timeout_s: at most {settings.max_idle_timeout_s:g}"
        raise ProblemError(ProblemCode.BAD_REQUEST, detail)
    return NewSession(upload.frame, boxes, options)


async def read_upload(request: Request, settings: Settings, *, raw: bool) -> Upload:
    """Return a frame and its fields; with ``raw`` the body may be the image itself."""
    kind = content_type(request)
    if _is_empty(request):
        raise (
            ProblemError(ProblemCode.UNSUPPORTED_IMAGE, EMPTY_FRAME)
            if raw
            else ProblemError(ProblemCode.BAD_REQUEST, EMPTY_SESSION)
        )
    if kind == FORM:
        return await _read_form(request, settings)
    if kind == JSON:
        limit = settings.max_json_frame_bytes * 4 // 3 + ENVELOPE_BYTES
        sent = parse(kind, await read(request, limit, settings, TOO_LARGE))
        return Upload(_from_base64(sent.pop("frame", None), settings), sent)
    if kind == MSGPACK:
        sent = parse(kind, await read(request, settings.max_frame_bytes + ENVELOPE_BYTES, settings, TOO_LARGE))
        frame = sent.pop("frame", None)
        if type(frame) is not bytes:
            raise ProblemError(ProblemCode.BAD_REQUEST, f"frame {_missing(frame)}the image's bytes (bin)")
        return Upload(_check_size(frame, settings), sent)
    if raw and (kind.startswith("image/") or kind in (BYTES, "")):
        image = await read(request, settings.max_frame_bytes, settings, TOO_LARGE)
        if not image:
            raise ProblemError(ProblemCode.UNSUPPORTED_IMAGE, EMPTY_FRAME)
        return Upload(image, {})
    raise _unsupported(kind, raw)


def refuse_others(sent: dict[str, Any], *known: str) -> None:
    """Raise bad-request if a field is left in ``sent``, from which those of ``known`` have been taken."""
    if sent:
        detail = f"unknown field {next(iter(sent))[:40]!r}; the fields are {', '.join(known)}"
        raise ProblemError(ProblemCode.BAD_REQUEST, detail)


def _unsupported(kind: str, raw: bool) -> ProblemError:
    if kind.startswith("image/"):
        detail = f"the image goes into a form beside its box: {FORM_CALL}"
        return ProblemError(ProblemCode.UNSUPPORTED_MEDIA_TYPE, detail)
    known = (FORM, JSON, MSGPACK, *(("image/*", BYTES) if raw else (SNAPSHOT,)))
    if kind == CURL_DEFAULT:
        call = RAW_CALL if raw else FORM_CALL
        detail = f"{CURL_DEFAULT} is curl's default; use {call} (Content-Type is one of {', '.join(known)})"
        return ProblemError(ProblemCode.UNSUPPORTED_MEDIA_TYPE, detail)
    return unsupported(*known)


def _boxes(sent: dict[str, Any]) -> list[list[float]]:
    """Take ``box`` or ``boxes`` out of ``sent``. Raises bad-request, bad-box."""
    if ("box" in sent) == ("boxes" in sent):
        given = "both are" if "box" in sent else "none is"
        detail = f"one of box (x, y, w, h) and boxes (a list of boxes) is needed; {given} given"
        raise ProblemError(ProblemCode.BAD_REQUEST, detail)
    given_boxes = [sent.pop("box")] if "box" in sent else sent.pop("boxes")
    if type(given_boxes) is not list or not given_boxes:
        detail = "boxes is a list of boxes, [[x, y, w, h], ...]; for one box, use box"
        raise ProblemError(ProblemCode.BAD_REQUEST, detail)
    return [check_box(box) for box in given_boxes]


def _is_empty(request: Request) -> bool:
    """Return whether the head announces no body."""
    return request.headers.get("content-length", "0") == "0" and "transfer-encoding" not in request.headers


def _missing(frame: Any) -> str:
    return "is missing; it is " if frame is None else "is "


async def _read_form(request: Request, settings: Settings) -> Upload:
    class Parser(MultiPartParser):
        spool_max_size = settings.max_frame_bytes + ENVELOPE_BYTES  # frames never touch a disk

    body = bounded(request, settings.max_frame_bytes + ENVELOPE_BYTES, TOO_LARGE)
    parser = Parser(request.headers, body, max_files=1, max_fields=8, max_part_size=ENVELOPE_BYTES)
    try:
        async with in_time(settings), contextlib.aclosing(body):
            form = await parser.parse()
    except MultiPartException as broken:
        why = "more than one file; only frame is a file" if "Too many files" in broken.message else broken.message
        raise ProblemError(ProblemCode.BAD_REQUEST, f"invalid multipart form: {why.rstrip('.')}") from broken
    except (KeyError, ValueError) as broken:
        detail = "invalid multipart form: the body is not multipart/form-data"
        raise ProblemError(ProblemCode.BAD_REQUEST, detail) from broken
    sent: dict[str, Any] = {}
    frame: bytes | None = None
    for name, value in form.multi_items():
        if name in sent or (name == "frame" and frame is not None):
            raise ProblemError(ProblemCode.BAD_REQUEST, f"{name[:40]} is given twice")
        if name == "frame" and isinstance(value, UploadFile):
            frame = await value.read()
            await value.close()
        elif isinstance(value, str):
            sent[name] = _form_field(name, value)
        elif name in FORM_FIELDS:
            detail = f"{name} is a text field, not a file; the image goes into frame"
            raise ProblemError(ProblemCode.BAD_REQUEST, detail)
        else:
            raise ProblemError(ProblemCode.BAD_REQUEST, f"the image goes into the field frame, not {name[:40]}")
    if frame is None:
        detail = "the image is missing: it is a file in the field frame"
        if "frame" in sent:
            detail = "frame is a text, not a file; with curl use -F frame=@frame.jpg"
        raise ProblemError(ProblemCode.BAD_REQUEST, detail)
    return Upload(_check_size(frame, settings), sent)


def _form_field(name: str, text: str) -> Any:
    if name not in FORM_FIELDS:
        return text
    if name == "box" and not text.lstrip().startswith("["):
        try:
            return [float(part) for part in text.split(",")]
        except ValueError:
            detail = "box is four numbers with commas between, x,y,w,h"
            raise ProblemError(ProblemCode.BAD_REQUEST, detail) from None
    try:
        return from_json(text)
    except Unreadable as unreadable:
        raise ProblemError(ProblemCode.BAD_REQUEST, f"{name}: {unreadable}") from unreadable


def _from_base64(text: Any, settings: Settings) -> bytes:
    if not isinstance(text, str):
        raise ProblemError(ProblemCode.BAD_REQUEST, f"frame {_missing(text)}the image in base64")
    if text.startswith("data:"):
        detail = "frame is the base64 alone: leave out everything up to the comma (data:...;base64,)"
        raise ProblemError(ProblemCode.BAD_REQUEST, detail)
    if len(text) * 3 // 4 > settings.max_json_frame_bytes + 2:
        raise ProblemError(TOO_LARGE, f"at most {settings.max_json_frame_bytes} bytes in JSON")
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        unbroken = " without line breaks" if "\n" in text else ""
        raise ProblemError(ProblemCode.BAD_REQUEST, f"frame is the image in base64{unbroken}") from None


def _check_size(frame: bytes, settings: Settings) -> bytes:
    if len(frame) > settings.max_frame_bytes:
        raise ProblemError(TOO_LARGE, f"{len(frame)} bytes; at most {settings.max_frame_bytes}")
    return frame
