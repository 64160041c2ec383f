"""What refuses a call, in words of the catalogue; faults of ours are the middleware's to tell."""

from __future__ import annotations

import re

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from ..problems import CATALOGUE, ProblemError
from .answers import problem_response

BY_STATUS = {404: "not-found", 405: "method-not-allowed", 413: "body-too-large"}


def install(app: FastAPI) -> None:
    """Make ``app`` answer failures with problems."""
    app.add_exception_handler(ProblemError, _problem)
    app.add_exception_handler(RequestValidationError, _validation)
    app.add_exception_handler(HTTPException, _http)


async def _problem(request: Request, problem: Exception) -> Response:
    assert isinstance(problem, ProblemError)
    request.state.problem = problem
    await request.app.state.service.late(request.scope)
    return problem_response(problem, request.state.request_id)


async def _validation(request: Request, wrong: Exception) -> Response:
    assert isinstance(wrong, RequestValidationError)
    first = wrong.errors()[0]
    place = ".".join(str(part)[:40] for part in first["loc"])
    return await _problem(request, ProblemError("bad-request", f"{place}: {first['msg']}"))


async def _http(request: Request, failed: Exception) -> Response:
    assert isinstance(failed, HTTPException)
    code = BY_STATUS.get(failed.status_code, "bad-request")
    problem = ProblemError(code, _to_a_stream(request) or CATALOGUE[code].example)
    problem.headers.update(failed.headers or {})
    if code == "method-not-allowed":
        problem.headers["Allow"] = ", ".join(_methods(request))
    return await _problem(request, problem)


def _to_a_stream(request: Request) -> str:
    """What a call is told that should have been a WebSocket; nothing for any other."""
    if not re.fullmatch(r"/v1/sessions/[^/]+/stream", request.url.path):
        return ""
    return "a stream is a WebSocket: connect with ws:// or wss://"


def _methods(request: Request) -> list[str]:
    """What the path knows: several routes share it, and the router names those of the first alone."""
    path = request.url.path
    for template, calls in request.app.openapi()["paths"].items():
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", template), path):
            return [name for method in calls for name in _with_head(method.upper())]
    return _with_head("GET")


def _with_head(method: str) -> list[str]:
    """Whoever may GET may ask for the head alone."""
    return ["GET", "HEAD"] if method == "GET" else [method]
