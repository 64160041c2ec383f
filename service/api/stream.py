"""The handshake of a stream: who, which session, which subprotocol; then the attachment takes over."""

from __future__ import annotations

from typing import Any, cast
from urllib.parse import parse_qs

import structlog
from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send

from ..connections import ABORT_EXTENSION, CROWDED, LEAVE_EXTENSION, SHARE
from ..keys import Identity
from ..observability.sampled import Sampled
from ..problems import ProblemError
from ..service import Service
from ..sessions.room import Share
from ..sessions.session import Session
from ..stream.attachment import StreamAttachment
from ..stream.codec import Codec, JsonCodec, MsgpackCodec
from ..stream.flow import Flow, Mode
from .answers import problem_response

CLOSE_CODES = {
    "unauthenticated": 4401,
    "host-refused": 4403,
    "origin-refused": 4403,
    "not-found": 4404,
    "session-not-found": 4404,
    "attached-elsewhere": 4409,
    "session-gone": 4410,
    "rate-limited": 4429,
    "over-quota": 4429,
    "at-capacity": 1013,
    "draining": 1013,
    "bad-request": 4400,
}

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.stream")
refusals = Sampled(log)


class StreamEndpoint:
    """The ASGI application behind ``/v1/sessions/{session_id}/stream``; raw, to keep frames off detours."""

    def __init__(self, service: Service) -> None:
        self._service = service

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        headers = Headers(scope=scope)
        await receive()  # websocket.connect
        codec, selected = _codec(scope["subprotocols"], self._service.settings.max_body_bytes)
        try:
            session, mode, identity = self._admit(scope, headers)
        except ProblemError as problem:
            await self._refuse(problem, codec, selected, scope, headers, send)
            return
        settings = self._service.settings
        superseded = self._service.metrics.frames_dropped.labels(reason="superseded").inc
        share = Share(self._service.room, identity.owner)
        if (connection := scope["state"].get(SHARE)) is not None:
            connection.belong(identity.owner)
        attachment = StreamAttachment(
            session,
            identity,
            codec,
            Flow(mode, settings.credit_frames, superseded, share),
            settings,
            self._service.meter,
            self._service.metrics,
            receive,
            send,
            scope["extensions"].get(ABORT_EXTENSION, lambda: None),
            scope["state"]["request_id"],
            scope["state"].get("span"),
        )
        if session.attachment is not None:
            session.attachment.end(4409, "attached elsewhere")
        session.attachment = attachment
        structlog.contextvars.bind_contextvars(session=session.id)
        await send({"type": "websocket.accept", "subprotocol": selected})
        await session.settled()
        log.info("stream attached", mode=mode, subprotocol=codec.name, seq=session.seq)
        await attachment.run(self._ready(session, mode, attachment.name, scope, headers))
        log.info("stream detached", seq=session.seq)

    def _admit(self, scope: Scope, headers: Headers) -> tuple[Session, Mode, Identity]:
        """The session that may be attached to, whatever is attached now. Raises ProblemError."""
        service = self._service
        service.gate.check_browser(headers)
        if scope["state"].get(CROWDED):
            raise ProblemError("at-capacity", "too many connections", retry_after_s=1.0)
        sid = scope["path_params"].get("session_id")
        if sid is None:
            raise ProblemError("not-found", "no WebSocket is here; a stream is at /v1/sessions/{session_id}/stream")
        identity = service.gate.redeem(scope["subprotocols"], sid) or service.gate.identify(headers)
        scope["state"]["identity"] = identity
        service.meter.call(identity.owner)
        if service.book.draining:
            raise ProblemError("draining", "the service is going away", retry_after_s=service.settings.drain_grace_s)
        query = parse_qs(scope["query_string"].decode("latin-1"))
        mode = query.get("mode", ["latest"])[-1]
        if mode not in ("latest", "lossless"):
            raise ProblemError("bad-request", "mode is latest or lossless")
        takeover = query.get("takeover", ["false"])[-1]
        if takeover not in ("true", "false"):
            raise ProblemError("bad-request", "takeover is true or false")
        session = service.book.find(identity.owner, sid)
        standing = session.attachment
        if standing is not None and takeover == "false" and query.get("resume") != [standing.name]:
            raise ProblemError("attached-elsewhere", "a stream is attached")
        if standing is None:
            self._check_room(identity.owner)
        return session, cast(Mode, mode), identity

    def _check_room(self, owner: str) -> None:
        """Raises over-quota, at-capacity for one stream too many."""
        book, settings = self._service.book, self._service.settings
        most = book.shares.streams
        if most < settings.max_streams and book.streams_of(owner) >= most:
            raise ProblemError("over-quota", f"at most {most} streams of a key", retry_after_s=1.0)
        if book.streams() >= settings.max_streams:
            raise ProblemError("at-capacity", "no room for another stream", retry_after_s=1.0)

    def _ready(self, session: Session, mode: Mode, name: str, scope: Scope, headers: Headers) -> dict[str, Any]:
        settings = self._service.settings
        base = f"{scope['scheme']}://{headers.get('host', '')}"
        return {
            "type": "ready",
            "session": self._service.describe(session, base),
            "mode": mode,
            "credit": settings.credit_frames if mode == "lossless" else None,
            "region_lag": settings.region_lag_frames,
            "next_seq": session.last_number + 1,
            "attachment": name,
            "lost_after": session.lost_after,
        }

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
        await self._service.late(scope)
        if "origin" not in headers and "websocket.http.response" in scope["extensions"]:
            response = problem_response(problem, scope["state"]["request_id"])
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
        await send(codec.write({"type": "error", "problem": problem.body(scope["state"]["request_id"])}))
        code = CLOSE_CODES.get(problem.code, 1011)
        await send({"type": "websocket.close", "code": code, "reason": problem.code})
        # Whoever was refused has nothing to say that anyone would read.
        scope["extensions"].get(LEAVE_EXTENSION, lambda: None)()


def _codec(offered: list[str], max_text_bytes: int) -> tuple[Codec, str | None]:
    """The first subprotocol of ours that is offered, and what the handshake says; JSON without any."""
    for name in offered:
        if name == MsgpackCodec.name:
            return MsgpackCodec(), name
        if name == JsonCodec.name:
            return JsonCodec(max_text_bytes), name
    return JsonCodec(max_text_bytes), None
