"""Media types: their names, the one that an ``Accept`` header prefers, and answers in the one that was chosen."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable, Mapping
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from .. import turns
from ..protocol.documents import to_json, to_msgpack
from ..protocol.enums import ProblemCode
from ..protocol.problems import MEDIA_TYPE, ProblemError

JSON, MSGPACK, FORM = "application/json", "application/msgpack", "multipart/form-data"
SNAPSHOT, BYTES = "application/vnd.mfcmt.snapshot", "application/octet-stream"
KSERVE = "/v2"
# Browsers send two hundred characters. Of a longer header only the beginning counts.
MAX_ACCEPT_CHARACTERS = 1024
MAX_TYPE_CHARACTERS = 256


def content_type(request: Request) -> str:
    """Return the media type of the body, without parameters. Raises unsupported-media-type for a very long one."""
    sent = request.headers.get("content-type", "")
    if len(sent) > MAX_TYPE_CHARACTERS:
        detail = f"Content-Type has at most {MAX_TYPE_CHARACTERS} characters"
        raise ProblemError(ProblemCode.UNSUPPORTED_MEDIA_TYPE, detail)
    return sent.partition(";")[0].strip().lower()


def unsupported(*known: str) -> ProblemError:
    """Return the refusal of a body whose media type is none of ``known``."""
    return ProblemError(ProblemCode.UNSUPPORTED_MEDIA_TYPE, f"Content-Type is one of {', '.join(known)}")


def preferred(request: Request, *offered: str) -> str:
    """Return the media type of ``offered`` that ``Accept`` prefers, the first one on a tie. Raises not-acceptable."""
    accept = request.headers.get("accept", "").strip()[:MAX_ACCEPT_CHARACTERS]
    if not accept:
        return offered[0]
    qualities: dict[str, float] = {}
    for part in accept.split(","):
        name, quality = _range(part)
        qualities.setdefault(name, quality)
    best = max(offered, key=lambda kind: _quality(kind, qualities))
    if not _quality(best, qualities):
        raise ProblemError(ProblemCode.NOT_ACCEPTABLE, f"the answer is available as {', '.join(offered)}")
    return best


def encode(kind: str, content: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """Return the answer ``content`` as JSON or MessagePack, which ``kind`` names."""
    if kind == MSGPACK:
        return Response(to_msgpack(content), status, headers, MSGPACK)
    return Response(to_json(content), status, headers, JSON)


async def in_parts(parts: Iterable[bytes | memoryview]) -> AsyncIterator[bytes | memoryview]:
    """Yield the parts of an answer, between which the event loop does other work."""
    for part in parts:
        yield part
        # Sending does not wait while the client reads fast.
        await asyncio.sleep(0)
        await turns.give_way()


def problem_response(problem: ProblemError, request_id: str, path: str) -> Response:
    """Return the answer to a refused call of ``path``, always as JSON."""
    headers = dict(problem.headers)
    if "retry_after_s" in problem.members:
        headers["Retry-After"] = str(max(1, round(problem.members["retry_after_s"])))
    document = problem.body(request_id)
    if path.startswith(KSERVE):
        document["error"] = problem.detail  # where its clients look
    return Response(to_json(document), problem.status, headers, MEDIA_TYPE)


def _range(part: str) -> tuple[str, float]:
    """Return a media range of ``Accept`` and its quality; one that cannot be read has quality 0."""
    kind, *params = (piece.strip().lower() for piece in part.split(";"))
    quality = 1.0
    for param in params:
        name, _, value = param.partition("=")
        if name.strip() == "q":
            try:
                quality = min(1.0, max(0.0, float(value)))
            except ValueError:
                quality = 0.0
    return kind, quality


def _quality(kind: str, qualities: Mapping[str, float]) -> float:
    """Return the quality of a media type: the most exact range decides (RFC 9110)."""
    family = kind.partition("/")[0] + "/*"
    return next((qualities[name] for name in (kind, family, "*/*") if name in qualities), 0.0)
