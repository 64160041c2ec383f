"""Refusals of calls as problems of the catalogue; the middleware answers faults of the service itself."""

from __future__ import annotations

import re

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from ..protocol.enums import ProblemCode
from ..protocol.problems import CATALOGUE, ProblemError
from .answers import problem_response

BY_STATUS = {
    404: ProblemCode.NOT_FOUND,
    405: ProblemCode.METHOD_NOT_ALLOWED,
    413: ProblemCode.BODY_TOO_LARGE,
}


def install(app: FastAPI) -> None:
    """Make ``app`` answer failures with problems."""
    app.add_exception_handler(ProblemError, _problem)
    app.add_exception_handler(RequestValidationError, _validation)
    app.add_exception_handler(HTTPException, _http)


async def _problem(request: Request, problem: Exception) -> Response:
    assert isinstance(problem, ProblemError)
    request.state.problem = problem
    await request.app.state.service.delay_refusal(request.scope)
    return problem_response(problem, request.state.request_id, request.url.path)


async def _validation(request: Request, wrong: Exception) -> Response:
    assert isinstance(wrong, RequestValidationError)
    first = wrong.errors()[0]
    place = ".".join(str(part)[:40] for part in first["loc"])
    return await _problem(request, ProblemError(ProblemCode.BAD_REQUEST, f"{place}: {first['msg']}"))


async def _http(request: Request, failed: Exception) -> Response:
    assert isinstance(failed, HTTPException)
    code = BY_STATUS.get(failed.status_code, ProblemCode.BAD_REQUEST)
    problem = ProblemError(code, _hint_of_stream(request) or CATALOGUE[code].example)
    problem.headers.update(failed.headers or {})
    if code is ProblemCode.METHOD_NOT_ALLOWED:
        problem.headers["Allow"] = ", ".join(_methods(request, (failed.headers or {}).get("Allow", "")))
    return await _problem(request, problem)


def _hint_of_stream(request: Request) -> str:
    """Return the detail for a call that should have been a WebSocket; "" for any other call."""
    if not re.fullmatch(r"/v1/sessions/[^/]+/stream", request.url.path):
        return ""
    return "a stream is a WebSocket: connect with ws:// or wss://"


def _methods(request: Request, listed: str) -> list[str]:
    """Return the methods of the path. Several routes may share it, and the router has ``listed`` the first's alone."""
    path = request.url.path
    for template, calls in request.app.openapi()["paths"].items():
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", template), path):
            return [name for method in calls for name in _with_head(method.upper())]
    return [name for method in (listed or "GET").split(", ") for name in _with_head(method)]  # a bridge, or no call


def _with_head(method: str) -> list[str]:
    """Return ``method``, and HEAD where it is GET."""
    return ["GET", "HEAD"] if method == "GET" else [method]
