"""The asyncio client."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from typing import Any, Self, TypeVar
from weakref import WeakSet

import httpx2
import msgpack

from .address import Address
from .connection import problem_of
from .errors import ConnectionLost, Problem
from .places import Places
from .session import MSGPACK, AsyncSession
from .sources import image_bytes, numbers
from .stream import AsyncStream
from .types import Image, SessionInfo, read_answer

T = TypeVar("T")
SNAPSHOT = "application/vnd.mfcmt.snapshot"
# How often a call that may be repeated is tried while the service cannot be reached.
ATTEMPTS, RETRY_DELAY_S = 3, 0.1
# How often a call is sent on to another node.
HOPS, HTTP_TEMPORARY_REDIRECT = 5, 307
# A place that another client gives up is free long before the service could foresee it.
ASK_AGAIN_S = 1.0
# How long a creation is tried again while the service has no ready lane or no place.
WAIT_S = 30.0


class AsyncClient:
    """A client of one service. All calls raise :class:`Problem` and :class:`ConnectionLost`.

    The environment's proxies (HTTP_PROXY, HTTPS_PROXY, ALL_PROXY) are used, except for this machine and for the hosts
    in NO_PROXY.

    Parameters
    ----------
    url
        The service's base URL. Raises ValueError for anything else.
    key
        An API key.
    timeout_s
        Limit of one call, in seconds.
    ping_interval_s
        A stream whose service answers no ping for this long counts as broken, in seconds.
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:8000",
        *,
        key: str | None = None,
        timeout_s: float = 30.0,
        ping_interval_s: float = 20.0,
    ) -> None:
        self.address = Address.of(url, key, ping_interval_s, timeout_s)
        self.places = Places(self.address)
        self._http = httpx2.AsyncClient(
            transport=httpx2.AsyncHTTPTransport(proxy=self.address.proxy_url),
            headers=self.address.headers,
            timeout=timeout_s,
        )
        self._streams: WeakSet[AsyncStream[Any]] = WeakSet()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Close what is open. Sessions live on until they are closed or time out."""
        for stream in list(self._streams):
            await stream.aclose()
        await self._http.aclose()

    async def create(
        self,
        frame: Image,
        box: Iterable[float] | None = None,
        *,
        boxes: Iterable[Iterable[float]] | None = None,
        wait_s: float = WAIT_S,
        **options: Any,
    ) -> AsyncSession:
        """Start a session on its first frame, with one ``box`` or several ``boxes``.

        Parameters
        ----------
        frame
            An encoded image, or the path of its file.
        box, boxes
            ``(x, y, w, h)`` in pixels of the frame; one of the two is needed.
        wait_s
            How long to ask again while the service has no ready lane or no place, in seconds.
        **options
            Those of the protocol: ``preset``, ``idle_timeout_s``, ``on_resize``, ``label``, ``maps``.
        """
        body: dict[str, Any] = {"frame": await image_bytes(frame)}
        if box is not None:
            body["box"] = numbers(box)
        if boxes is not None:
            body["boxes"] = [numbers(each) for each in boxes]
        if options:
            body["options"] = options
        return await self._create(msgpack.packb(body), MSGPACK, wait_s)

    async def restore(self, snapshot: Image, *, wait_s: float = WAIT_S) -> AsyncSession:
        """Start a session that goes on where a snapshot was taken; ``wait_s`` as in :meth:`create`."""
        return await self._create(await image_bytes(snapshot, "a snapshot"), SNAPSHOT, wait_s)

    async def session(self, session_id: str) -> AsyncSession:
        """Return a session that exists."""
        return AsyncSession(self, read_answer(SessionInfo, await self.json("GET", f"/v1/sessions/{session_id}")))

    async def sessions(self) -> AsyncIterator[SessionInfo]:
        """Yield the caller's own sessions."""
        after = None
        while True:
            page = await self.json("GET", "/v1/sessions", params={} if after is None else {"after": after})
            for session in page["sessions"]:
                yield read_answer(SessionInfo, session)
            after = page.get("next")
            if after is None:
                return

    async def capabilities(self) -> dict[str, Any]:
        """Return limits, presets, image types and versions."""
        return dict(await self.json("GET", "/v1/capabilities"))

    async def json(self, method: str, path: str, **request: Any) -> Any:
        """Make one HTTP call and return the decoded answer."""
        return (await self.call(method, path, **request)).json()

    async def call(
        self, method: str, path: str, *, headers: Mapping[str, str] | None = None, **request: Any
    ) -> httpx2.Response:
        """Make one HTTP call, again while the service cannot be reached if the call may be repeated."""
        headers = dict(headers or {})
        attempts = ATTEMPTS if method != "POST" or "Idempotency-Key" in headers else 1
        for attempt in range(1, attempts + 1):
            try:
                answer = await self._request(method, path, headers=headers, **request)
            except httpx2.TransportError as failed:
                if attempt == attempts:
                    raise ConnectionLost(self.address.failed(failed)) from failed
                await asyncio.sleep(RETRY_DELAY_S * 2**attempt)
            else:
                break
        if answer.is_success:
            self.places.learn(answer.headers.get("Location", ""))
            return answer
        problem = problem_of(answer.status_code, answer.content, self.address.way)
        if problem.retry_after_s is None and (after := answer.headers.get("Retry-After", "")).isdigit():
            problem.retry_after_s = float(after)
        raise problem

    async def _request(self, method: str, path: str, **request: Any) -> httpx2.Response:
        """Make one HTTP call at the node that has the session, with the key, which httpx would leave out elsewhere."""
        url = self.places.url(path)
        for _ in range(HOPS):
            try:
                answer = await self._http.request(method, url, **request)
            except httpx2.ConnectError:
                if not self.places.forget_url(url):
                    raise
                url = self.places.url(path)
                continue
            if answer.status_code != HTTP_TEMPORARY_REDIRECT or "Location" not in answer.headers:
                return answer
            if self.address.url.startswith("https") and not answer.headers["Location"].startswith("https"):
                return answer
            url = answer.headers["Location"]
            request.pop("params", None)  # they are in the URL
            self.places.learn(url)
        return answer

    async def settle(self, session_id: str) -> None:
        """Wait until those streams of a session have ended whose loops were left."""
        for stream in [stream for stream in self._streams if stream.left and stream.session_id == session_id]:
            await stream.aclose()
            self._streams.discard(stream)

    async def _create(self, body: bytes, media_type: str, wait_s: float) -> AsyncSession:
        headers = {"Content-Type": media_type, "Idempotency-Key": secrets.token_urlsafe(16)}
        give_up = time.monotonic() + wait_s
        while True:
            try:
                made = await self.json("POST", "/v1/sessions", content=body, headers=headers)
            except Problem as refused:
                if refused.status != 503 or refused.retry_after_s is None or time.monotonic() >= give_up:
                    raise
                await asyncio.sleep(min(refused.retry_after_s, ASK_AGAIN_S, max(0.0, give_up - time.monotonic())))
            else:
                return AsyncSession(self, read_answer(SessionInfo, made))

    def remember(self, stream: AsyncStream[T]) -> AsyncStream[T]:
        """Close ``stream`` with the client, and return it."""
        self._streams.add(stream)
        return stream
