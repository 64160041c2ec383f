"""The handshake of a stream: who connects, to which session, by which subprotocol and in which mode."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import parse_qs

import structlog
from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send

from ..connections import ABORT_EXTENSION, LEAVE_EXTENSION, OVER_CONNECTION_LIMIT, SHARE, WRITE_EXTENSION
from ..keys import Identity
from ..observability.sampled import Sampled
from ..protocol.answers import Error, Ready, message
from ..protocol.codecs import CODECS, JSON, Codec
from ..protocol.enums import CloseCode, Mode, ProblemCode
from ..protocol.problems import CLOSE_OF_REFUSAL, ProblemError
from ..service import Service
from ..sessions.byte_budget import Reservation
from ..sessions.session import Session
from ..stream.connection import StreamConnection
from ..stream.frame_queue import FrameQueue
from ..stream.sender import websocket_send
from .answers import problem_response

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.stream")
refusals = Sampled(log)


class StreamEndpoint:
    """The ASGI application behind ``/v1/sessions/{session_id}/stream``; raw, to keep frames off detours.

    Among several nodes, ``prepare`` makes sure that the session is at this one. Raises elsewhere.
    """

    def __init__(self, service: Service, prepare: Callable[[Scope, Headers], Awaitable[None]] | None = None) -> None:
        self._service, self._prepare = service, prepare

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        headers = Headers(scope=scope)
        await receive()  # websocket.connect
        # The first of ours that is offered; JSON, which the answer then does not name, where none is.
        selected = next((name for name in scope["subprotocols"] if name in CODECS), None)
        codec = JSON if selected is None else CODECS[selected]
        try:
            if self._prepare is not None:
                await self._prepare(scope, headers)
            session, mode, identity = self._admit(scope, headers)
        except ProblemError as problem:
            await self._refuse(problem, codec, selected, scope, headers, send)
            return
        settings = self._service.settings
        superseded = self._service.metrics.frames_dropped.labels(reason="superseded").inc
        share = Reservation(self._service.byte_budget, identity.owner)
        if (held := scope["state"].get(SHARE)) is not None:
            held.assign(identity.owner)
        connection = StreamConnection(
            session,
            identity,
            codec,
            FrameQueue(mode, settings.credit_frames, superseded, share),
            settings,
            self._service.rate_limiter,
            self._service.metrics,
            receive,
            send,
            scope["extensions"].get(WRITE_EXTENSION, lambda _: False),
            scope["extensions"].get(ABORT_EXTENSION, lambda: None),
            scope["state"]["request_id"],
            scope["state"].get("span"),
        )
        if session.attachment is not None:
            session.attachment.end(CloseCode.ATTACHED_ELSEWHERE, "attached elsewhere")
        session.attachment = connection
        structlog.contextvars.bind_contextvars(session=session.id)
        await send({"type": "websocket.accept", "subprotocol": selected})
        await session.wait_until_idle()
        log.info("stream attached", mode=mode.value, subprotocol=codec.name, seq=session.seq)
        await connection.run(self._ready(session, mode, connection.name, scope, headers))
        log.info("stream detached", seq=session.seq)

    def _admit(self, scope: Scope, headers: Headers) -> tuple[Session, Mode, Identity]:
        """Return the session that the client may attach to, the mode, and who it is. Raises ProblemError."""
        service = self._service
        service.authenticator.check_browser(headers)
        if scope["state"].get(OVER_CONNECTION_LIMIT):
            raise ProblemError(ProblemCode.AT_CAPACITY, "too many connections", retry_after_s=1.0)
        sid = scope["path_params"].get("session_id")
        if sid is None:
            detail = "no WebSocket is here; a stream is at /v1/sessions/{session_id}/stream"
            raise ProblemError(ProblemCode.NOT_FOUND, detail)
        identity = service.authenticator.redeem(scope["subprotocols"], sid) or service.authenticator.identify(headers)
        scope["state"]["identity"] = identity
        service.rate_limiter.count_call(identity.owner)
        if service.registry.draining:
            grace_s = service.settings.drain_grace_s
            raise ProblemError(ProblemCode.DRAINING, "the service is shutting down", retry_after_s=grace_s)
        query = parse_qs(scope["query_string"].decode("latin-1"))
        mode = query.get("mode", ["latest"])[-1]
        if mode not in list(Mode):
            raise ProblemError(ProblemCode.BAD_REQUEST, f"mode is {' or '.join(Mode)}")
        takeover = query.get("takeover", ["false"])[-1]
        if takeover not in ("true", "false"):
            raise ProblemError(ProblemCode.BAD_REQUEST, "takeover is true or false")
        session = service.registry.find(identity.owner, sid)
        standing = session.attachment
        if standing is not None and takeover == "false" and query.get("resume") != [standing.name]:
            raise ProblemError(ProblemCode.ATTACHED_ELSEWHERE, "a stream is attached")
        if standing is None:
            self._check_quota(identity.owner)
        return session, Mode(mode), identity

    def _check_quota(self, owner: str) -> None:
        """Make sure that ``owner`` may attach another stream. Raises over-quota, at-capacity."""
        registry, settings = self._service.registry, self._service.settings
        most = registry.quotas.streams
        elsewhere = self._service.node.streams_elsewhere(owner) if self._service.node else 0
        if most < settings.max_streams and registry.streams_of(owner) + elsewhere >= most:
            raise ProblemError(ProblemCode.OVER_QUOTA, f"at most {most} streams of a key", retry_after_s=1.0)
        if registry.streams() >= settings.max_streams:
            raise ProblemError(ProblemCode.AT_CAPACITY, "no room for another stream", retry_after_s=1.0)

    def _ready(self, session: Session, mode: Mode, name: str, scope: Scope, headers: Headers) -> dict[str, Any]:
        settings = self._service.settings
        base = f"{scope['scheme']}://{headers.get('host', '')}"
        return message(
            Ready,
            session=self._service.describe(session, base),
            mode=mode.value,
            credit=settings.credit_frames if mode is Mode.LOSSLESS else None,
            region_lag=settings.region_lag_frames,
            next_seq=session.last_number + 1,
            attachment=name,
            lost_after=session.lost_after,
        )

    async def _refuse(
        self,
        problem: ProblemError,
        codec: Codec,
        selected: str | None,
        scope: Scope,
        headers: Headers,
        send: Send,
    ) -> None:
        self._service.metrics.problems.labels(code=problem.code).inc()
        refusals.info("stream refused", code=problem.code)
        if problem.code is not ProblemCode.ELSEWHERE:
            await self._service.delay_refusal(scope)
        if "origin" not in headers and "websocket.http.response" in scope["extensions"]:
            response = problem_response(problem, scope["state"]["request_id"], scope["path"])
            await send(
                {
                    "type": "websocket.http.response.start",
                    "status": response.status_code,
                    "headers": response.raw_headers,
                }
            )
            await send({"type": "websocket.http.response.body", "body": response.body})
            return
        # A browser's script cannot see the status of a refused handshake, but it sees this.
        await send({"type": "websocket.accept", "subprotocol": selected})
        refusal = message(Error, problem=problem.body(scope["state"]["request_id"]), seq=None, ref=None)
        await send(websocket_send(codec.encode(refusal)))
        code = CLOSE_OF_REFUSAL.get(problem.code, CloseCode.INTERNAL)
        await send({"type": "websocket.close", "code": code, "reason": problem.code})
        # Nobody reads what a refused client sends from now on.
        scope["extensions"].get(LEAVE_EXTENSION, lambda: None)()
