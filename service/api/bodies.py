"""Bodies as bytes and documents: read within a limit of size and of time."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, AsyncIterator
from typing import Any

from pydantic import ValidationError
from starlette.requests import ClientDisconnect, Request

from .. import turns
from ..connections import SHARE
from ..landing import LARGE_BYTES, Landing
from ..protocol.documents import Unreadable, from_json, from_msgpack
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.schema import T, adapter
from ..sessions.byte_budget import Reservation
from ..settings import Settings
from .answers import JSON, MSGPACK, content_type, unsupported

# The key in the state of a scope under which a call's share of the byte budget is, until it is answered.
HELD = "mfcmt.held"


async def read(
    request: Request, limit: int, settings: Settings, code: ProblemCode = ProblemCode.BODY_TOO_LARGE
) -> bytes | memoryview:
    """Return the whole body. Raises ``code`` above ``limit`` bytes, deadline-exceeded, bad-request."""
    if LARGE_BYTES < (announced := announced_bytes(request)) <= limit:
        landing = Landing(announced)
        async with in_time(settings):
            async for part in bounded(request, limit, code):
                landing.add(part)
        await turns.give_way()  # to read a large document takes a turn of its own
        return landing.taken()
    first, more = b"", bytearray()
    async with in_time(settings):
        async for part in bounded(request, limit, code):
            if not first:
                first = part
            else:
                more += part if more else first + part
    return memoryview(more) if more else first


async def read_document(request: Request, settings: Settings) -> dict[str, Any]:
    """Return a JSON or MessagePack map; an empty body is an empty map."""
    kind = content_type(request)
    data = await read(request, settings.max_body_bytes, settings)
    if not data:
        return {}
    if kind not in (JSON, MSGPACK):
        raise unsupported(JSON, MSGPACK)
    return parse(kind, data)


def parse(kind: str, data: bytes | memoryview) -> dict[str, Any]:
    """Return the map that ``data`` holds as JSON or MessagePack. Raises bad-request."""
    try:
        document = from_json(bytes(data)) if kind == JSON else from_msgpack(data)
    except Unreadable as unreadable:
        raise ProblemError(ProblemCode.BAD_REQUEST, str(unreadable)) from unreadable
    if not isinstance(document, dict):
        raise ProblemError(ProblemCode.BAD_REQUEST, "the body is a map of named fields")
    return document


def validated(kind: type[T], document: Any) -> T:
    """Return ``document`` as ``kind``. Raises bad-request, which names the field and never repeats the value."""
    try:
        return adapter(kind).validate_python(document)
    except ValidationError as wrong:
        first = wrong.errors(include_input=False, include_url=False, include_context=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"]) or "body"
        raise ProblemError(ProblemCode.BAD_REQUEST, f"{place}: {first['msg']}") from None


def announced_bytes(request: Request) -> int:
    """Return the length of the body as its head says it, 0 if it does not."""
    length = request.headers.get("content-length", "")
    return int(length[:20]) if length.isdecimal() else 0


@contextlib.asynccontextmanager
async def in_time(settings: Settings) -> AsyncIterator[None]:
    """Limit the time in which a body is read. Raises deadline-exceeded, and bad-request if the client goes."""
    try:
        async with asyncio.timeout(settings.body_timeout_s):
            yield
    except TimeoutError as slow:
        raise ProblemError(ProblemCode.DEADLINE_EXCEEDED, "the body took too long") from slow
    except ClientDisconnect as gone:
        raise ProblemError(ProblemCode.BAD_REQUEST, "the body ended early") from gone


async def bounded(request: Request, limit: int, code: ProblemCode) -> AsyncGenerator[bytes, None]:
    """Yield the parts of the body as they arrive. Raises ``code`` above ``limit`` bytes, at-capacity.

    An announced length is held from the beginning: of two bodies for which there is not room enough, the first is read.
    """
    too_large = ProblemError(code, f"at most {limit} bytes")
    announced = announced_bytes(request)
    if announced > limit:
        raise too_large
    share: Reservation = request.scope["state"][HELD]
    share.grow(announced)
    if (connection := request.scope["state"].get(SHARE)) is not None:
        connection.elsewhere = announced
    read_bytes = 0
    async for part in request.stream():
        read_bytes += len(part)
        share.grow(max(0, min(len(part), read_bytes - announced)))
        if read_bytes > limit:
            raise too_large
        if part:
            yield part
