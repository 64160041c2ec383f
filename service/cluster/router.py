"""Calls on sessions of other nodes: small ones are passed on, others are told where to go."""

from __future__ import annotations

import asyncio
import re

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from ..api import bodies
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..settings import Settings
from .calls import NoAnswer, NodeCalls, Unreachable
from .membership import LEASE_S
from .node import ClusterNode

SESSION = re.compile(r"/v1/sessions/([^/]+)(/.*)?")
# The calls whose bodies and answers are small; the others carry images, whole pasts or streams.
SMALL = re.compile(r"(/targets(/[^/]*)?|/ticket)?")
# Says of a call that a node has passed it on, so that two nodes never pass it to and fro.
PASSED_ON = "mfcmt-passed-on"
# Headers of one connection, and those that this node has checked or answers itself (RFC 9110, 7.6.1).
OWN = {
    *("connection", "keep-alive", "proxy-authenticate", "proxy-authorization", "te", "trailer", "transfer-encoding"),
    *("upgrade", "host", "origin", "content-length", "accept-encoding", "expect", "date", "server", "x-request-id"),
    *("access-control-request-method", "access-control-request-headers"),
}
NO_CONTENT = 204
LOOK_AGAIN_S = 0.25
# How much longer than a lease a call waits for a node that does not answer.
BEYOND_S = 1.0


class SessionRouter:
    """Surrounds the calls of a node; a session that is here costs one look into a map."""

    def __init__(self, app: ASGIApp, node: ClusterNode, settings: Settings) -> None:
        self._app, self._node, self._settings = app, node, settings
        self._calls = NodeCalls()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one call, or pass it on."""
        found = SESSION.fullmatch(scope["path"]) if scope["type"] == "http" else None
        identity = scope["state"].get("identity") if found else None
        if found is None or identity is None:
            await self._app(scope, receive, send)
            return
        sid, below = found[1], found[2] or ""
        query = scope["query_string"].decode("latin-1")
        rest = f"{below}{'?' if query else ''}{query}"
        headers = Headers(scope=scope)
        body: bytes | None = None
        give_up = asyncio.get_running_loop().time() + LEASE_S + BEYOND_S
        while True:
            try:
                await self._node.locate(identity.owner, sid, rest)
            except ProblemError as elsewhere:
                if elsewhere.code is not ProblemCode.ELSEWHERE:
                    raise
                if PASSED_ON in headers or not self._is_small(below, headers):
                    raise
                body = await self._read(scope, receive) if body is None else body
                if await self._pass_on(str(elsewhere.members["url"]), scope, headers, body, send):
                    return
                if asyncio.get_running_loop().time() > give_up:
                    detail = f"{elsewhere.detail} and does not answer"
                    raise ProblemError(ProblemCode.AT_CAPACITY, detail, retry_after_s=1.0) from elsewhere
                # Its lease runs out soon; then the session is taken up.
                await asyncio.sleep(LOOK_AGAIN_S)
            else:
                break
        await self._app(scope, receive if body is None else _Again(body, receive), send)

    def _is_small(self, below: str, headers: Headers) -> bool:
        length = headers.get("content-length", "0")
        whole = "transfer-encoding" not in headers and length.isdecimal()
        return whole and int(length[:12]) <= self._settings.max_body_bytes and SMALL.fullmatch(below) is not None

    async def _read(self, scope: Scope, receive: Receive) -> bytes:
        return bytes(await bodies.read(Request(scope, receive), self._settings.max_body_bytes, self._settings))

    async def _pass_on(self, url: str, scope: Scope, headers: Headers, body: bytes, send: Send) -> bool:
        """Pass a call on and its answer back; return False if the other node cannot be reached."""
        passed = [(name, value) for name, value in headers.items() if name not in OWN]
        passed += [(PASSED_ON, self._node.me.name), ("X-Request-ID", scope["state"]["request_id"])]
        try:
            answer = await self._calls.call(scope["method"], url, passed, body)
        except Unreachable:
            self._node.forget_place(url)
            return False
        except NoAnswer as failed:
            self._node.forget_place(url)
            detail = f"the node that has the session does not answer ({failed})"
            raise ProblemError(ProblemCode.AT_CAPACITY, detail, retry_after_s=1.0) from failed
        back = [(name, value) for name, value in answer.headers if name.decode() not in OWN]
        if answer.status != NO_CONTENT:
            back.append((b"content-length", str(len(answer.body)).encode()))
        await send({"type": "http.response.start", "status": answer.status, "headers": back})
        await send({"type": "http.response.body", "body": answer.body})
        return True


class _Again:
    """A ``receive`` that gives the body again, which was read before."""

    def __init__(self, body: bytes, receive: Receive) -> None:
        self._body: bytes | None = body
        self._receive = receive

    async def __call__(self) -> dict[str, object]:
        body, self._body = self._body, None
        if body is None:
            return dict(await self._receive())
        return {"type": "http.request", "body": body, "more_body": False}
