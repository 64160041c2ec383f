"""The middleware of every call and handshake: request ids, authentication, CORS, HEAD, metrics and one log line."""

from __future__ import annotations

import re
import secrets
import time
from typing import Any

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .. import turns
from ..bridges import BRIDGES
from ..connections import OVER_CONNECTION_LIMIT, SHARE
from ..observability.sampled import Sampled
from ..protocol.enums import ProblemCode
from ..protocol.problems import CATALOGUE, ProblemError
from ..service import Service
from ..sessions.byte_budget import Reservation
from .answers import problem_response
from .bodies import HELD

SANE_ID = re.compile(r"[A-Za-z0-9._:/+=-]{1,128}")
# Frequent calls are logged at debug level, unless they are refused.
PROBES = {"/livez", "/readyz", "/metrics", "/static/{path:path}", "/v2/health/live", "/v2/health/ready"}
FREQUENT = {
    *PROBES,
    "/v1/sessions/{session_id}/frames",
    "/api/function_invocations",
    "/v2/models/{model}/infer",
    "/v2/models/{model}/versions/{version}/infer",
}
STREAM = "/v1/sessions/{session_id}/stream"
SAFE_HEADERS = (
    ("X-Content-Type-Options", "nosniff"),
    ("Cache-Control", "no-store"),
    ("Referrer-Policy", "no-referrer"),
)
EXPOSED = "Location, Retry-After, X-Request-ID"

# The key in the state of a scope under which the caller's identity is.
IDENTITY = "identity"

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.http")
refusals = Sampled(log)


class RequestMiddleware:
    """Surrounds every call and handshake; the messages of an accepted stream pass untouched."""

    def __init__(self, app: ASGIApp, service: Service) -> None:
        self._app, self._service = app, service
        guarded = (BRIDGES[name].guarded for name in service.settings.bridges)
        self._guarded = re.compile("|".join(("/v1/", *guarded)))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one call or handshake."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        given = headers.get("x-request-id", "")
        request_id = given if SANE_ID.fullmatch(given) else secrets.token_hex(8)
        scope.setdefault("state", {})["request_id"] = request_id
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request_id=request_id)
        if (tracing := self._service.metrics.tracing) is not None:
            span = scope["state"]["span"] = tracing.begin(scope.get("method", "GET"), headers)
            if trace_id := tracing.id(span):
                structlog.contextvars.bind_contextvars(trace_id=trace_id)
        if scope["type"] == "websocket":
            await self._app(scope, receive, self._handshake(scope, send, request_id))
        else:
            await self._http(scope, receive, send, headers, request_id)

    async def _http(self, scope: Scope, receive: Receive, send: Send, headers: Headers, request_id: str) -> None:
        began = time.monotonic()
        status = 0
        head_only = scope["method"] == "HEAD"
        asked: Scope = {**scope, "method": "GET"} if head_only else scope  # every GET has its HEAD (RFC 9110, 9.3.2)

        async def answer(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                answered = MutableHeaders(raw=message.setdefault("headers", []))
                answered["X-Request-ID"] = request_id
                for name, value in SAFE_HEADERS:
                    answered.setdefault(name, value)
                self._add_cors(headers, answered)
            elif head_only:
                message = {**message, "body": b""}
            await send(message)

        await turns.give_way()
        held = scope["state"][HELD] = Reservation(self._service.byte_budget)
        try:
            self._service.authenticator.check_browser(headers)
            if scope["state"].get(OVER_CONNECTION_LIMIT) and scope["path"] not in PROBES:
                raise _too_many_connections()
            self._admit(scope, headers)
            if scope["method"] == "OPTIONS" and "access-control-request-method" in headers:
                await _preflight(headers)(asked, receive, answer)
            else:
                await self._app(asked, receive, answer)
        except ProblemError as refused:
            scope["state"]["problem"] = refused
            if refused.code is not ProblemCode.ELSEWHERE:
                await self._service.delay_refusal(scope)
            await problem_response(refused, request_id, scope["path"])(asked, receive, answer)
        except Exception:
            log.exception("internal error")
            if status == 0:
                problem = ProblemError(ProblemCode.INTERNAL, CATALOGUE[ProblemCode.INTERNAL].example)
                scope["state"]["problem"] = problem
                await problem_response(problem, request_id, scope["path"])(asked, receive, answer)
        finally:
            held.resize(0)
            self._record(asked, scope["method"], status, time.monotonic() - began)

    def _admit(self, scope: Scope, headers: Headers) -> None:
        """Authenticate the caller before anything else is done. Raises unauthenticated, rate-limited."""
        if scope["method"] == "OPTIONS" or not self._guarded.match(scope["path"]):
            return
        state = scope["state"]
        identity = state[IDENTITY] = self._service.authenticator.identify(headers)
        self._service.rate_limiter.count_call(identity.owner)
        for share in (state[HELD], state.get(SHARE)):
            if share is not None:
                share.assign(identity.owner)

    def _add_cors(self, headers: Headers, answered: MutableHeaders) -> None:
        if (origin := headers.get("origin")) is not None:
            answered.add_vary_header("Origin")
            if self._service.authenticator.allows(origin.lower(), headers.get("host", "").lower()):
                answered["Access-Control-Allow-Origin"] = origin
                answered["Access-Control-Expose-Headers"] = EXPOSED

    def _record(self, scope: Scope, method: str, status: int, took_s: float) -> None:
        # The route's template, not the path: a session's id must not become a label.
        path = getattr(scope.get("route"), "path", "other")
        if scope["path"].startswith("/v1/") and path != "other":
            path = "/v1" + path.removeprefix("/v1")
        metrics = self._service.metrics
        metrics.requests.labels(method=_known(method), path=path, status=status).inc()
        metrics.request_seconds.observe(took_s)
        line: dict[str, Any] = {"method": method, "path": path, "status": status}
        if session := scope.get("path_params", {}).get("session_id"):
            line["session"] = session[:64]
        problem = scope["state"].get("problem")
        if problem is not None:
            metrics.problems.labels(code=problem.code).inc()
            line |= {"code": problem.code, "detail": problem.detail}
        self._trace(scope, path, status)
        line["ms"] = round(took_s * 1e3, 3)
        if problem is not None and path not in PROBES:
            refusals.info("call", **line)
        else:
            (log.debug if path in FREQUENT else log.info)("call", **line)

    def _trace(self, scope: Scope, path: str, status: int) -> None:
        if (tracing := self._service.metrics.tracing) is not None:
            problem = scope["state"].get("problem")
            method = _known(scope.get("method", "GET"))
            tracing.end(scope["state"]["span"], method, path, status, problem and problem.code)

    def _handshake(self, scope: Scope, send: Send, request_id: str) -> Send:
        async def answer(message: Message) -> None:
            if message["type"] in ("websocket.accept", "websocket.http.response.start"):
                MutableHeaders(raw=message.setdefault("headers", []))["X-Request-ID"] = request_id
                self._trace(scope, STREAM, message.get("status", 101))
            await send(message)

        return answer


def _too_many_connections() -> ProblemError:
    problem = ProblemError(ProblemCode.AT_CAPACITY, "too many connections", retry_after_s=1.0)
    problem.headers["Connection"] = "close"
    return problem


def _known(method: str) -> str:
    return method if method in ("GET", "POST", "PUT", "DELETE", "HEAD", "OPTIONS", "PATCH") else "other"


def _preflight(headers: Headers) -> Any:
    return Response(
        status_code=204,
        headers={
            "Access-Control-Allow-Methods": "GET, POST, PUT, DELETE",
            "Access-Control-Allow-Headers": headers.get("access-control-request-headers", ""),
            "Access-Control-Max-Age": "600",
        },
    )
