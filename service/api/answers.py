"""Answers as they go out: JSON or MessagePack by ``Accept``, problems always as problem+json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from ..problems import MEDIA_TYPE, ProblemError
from ..schemas.packed import to_json, to_msgpack
from .bodies import JSON, MSGPACK

# Browsers send two hundred; of a longer one the beginning counts.
MAX_ACCEPT_CHARACTERS = 1024


def chosen_type(request: Request, *offered: str) -> str:
    """The media type of ``offered`` that the caller likes best, the first on a tie. Raises not-acceptable."""
    accept = request.headers.get("accept", "").strip()[:MAX_ACCEPT_CHARACTERS]
    if not accept:
        return offered[0]
    ranges = [_range(part) for part in accept.split(",")]
    best, best_quality = "", 0.0
    for kind in offered:
        quality = _quality(kind, ranges)
        if quality > best_quality:
            best, best_quality = kind, quality
    if not best:
        raise ProblemError("not-acceptable", f"{', '.join(offered)} can be made")
    return best


def answer(kind: str, status: int, content: Any, headers: Mapping[str, str] | None = None) -> Response:
    """``content`` in the media type that was chosen."""
    if kind == MSGPACK:
        return Response(to_msgpack(content), status, headers, MSGPACK)
    return Response(to_json(content), status, headers, JSON)


def problem_response(problem: ProblemError, request_id: str) -> Response:
    """The answer to a refused call."""
    headers = dict(problem.headers)
    if "retry_after_s" in problem.members:
        headers["Retry-After"] = str(max(1, round(problem.members["retry_after_s"])))
    return Response(to_json(problem.body(request_id)), problem.status, headers, MEDIA_TYPE)


def _range(part: str) -> tuple[str, float]:
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


def _quality(kind: str, ranges: list[tuple[str, float]]) -> float:
    """RFC 9110: the most exact range decides."""
    family = kind.partition("/")[0] + "/*"
    for name in (kind, family, "*/*"):
        for range_, quality in ranges:
            if range_ == name:
                return quality
    return 0.0
