"""The asyncio client."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterable, AsyncIterator, Callable, Iterable, Mapping
from typing import Any, Literal, Self, TypeVar, overload
from weakref import WeakSet

import httpx2
import msgpack

from .address import Address
from .connect import Connector
from .connection import Protocol, problem_of
from .errors import ConnectionLost, Problem
from .sources import as_frame, image_bytes, numbers
from .stream import AsyncStream
from .types import (
    Frame,
    Image,
    Mode,
    Region,
    Result,
    Resumed,
    SessionInfo,
    TargetChange,
    Ticket,
    read_answer,
    read_past_result,
)

T = TypeVar("T")
MSGPACK = "application/msgpack"
SNAPSHOT = "application/vnd.mfcmt.snapshot"
# How often a call that may be repeated is tried while the service cannot be reached.
ATTEMPTS, RETRY_DELAY_S = 3, 0.1
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
        self._http = httpx2.AsyncClient(
            transport=httpx2.AsyncHTTPTransport(proxy=self.address.proxy_url),
            base_url=self.address.url,
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
                answer = await self._http.request(method, path, headers=headers, **request)
            except httpx2.TransportError as failed:
                if attempt == attempts:
                    raise ConnectionLost(self.address.failed(failed)) from failed
                await asyncio.sleep(RETRY_DELAY_S * 2**attempt)
            else:
                break
        if answer.is_success:
            return answer
        problem = problem_of(answer.status_code, answer.content, self.address.way)
        if problem.retry_after_s is None and (after := answer.headers.get("Retry-After", "")).isdigit():
            problem.retry_after_s = float(after)
        raise problem

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
                await asyncio.sleep(min(refused.retry_after_s, max(0.0, give_up - time.monotonic())))
            else:
                return AsyncSession(self, read_answer(SessionInfo, made))

    def _attached(self, stream: AsyncStream[T]) -> AsyncStream[T]:
        self._streams.add(stream)
        return stream


class AsyncSession:
    """One session; ``async with`` closes it at the end. ``info`` is the session as the service described it last."""

    def __init__(self, client: AsyncClient, info: SessionInfo) -> None:
        self._client = client
        self._path = f"/v1/sessions/{info.id}"
        self.info = info

    @property
    def id(self) -> str:
        return self.info.id

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def refresh(self) -> SessionInfo:
        """Ask the service for the session again, and return it."""
        self.info = read_answer(SessionInfo, await self._client.json("GET", self._path))
        return self.info

    async def close(self) -> None:
        """End the session."""
        await self._client.call("DELETE", self._path)

    async def track(self, frame: Image | Frame) -> Result:
        """Track one frame over HTTP and return its result; streams are faster."""
        frame = await as_frame(frame)
        await self._client.settle(self.id)
        body = {"frame": frame.data, "seq": frame.seq, "ts": frame.ts, "region": frame.region}
        packed = msgpack.packb({name: value for name, value in body.items() if value is not None})
        headers = {"Content-Type": MSGPACK}
        answer = await self._client.json("POST", f"{self._path}/frames", content=packed, headers=headers)
        return read_answer(Result, answer)

    async def add_target(self, box: Iterable[float]) -> TargetChange:
        """Start another target on the newest frame, and return it."""
        body = {"box": numbers(box)}
        return read_answer(TargetChange, await self._client.json("POST", f"{self._path}/targets", json=body))

    async def correct_target(self, target: int, box: Iterable[float]) -> TargetChange:
        """Put a target right on the newest frame, and return it."""
        body = {"box": numbers(box)}
        answer = await self._client.json("PUT", f"{self._path}/targets/{target}", json=body)
        return read_answer(TargetChange, answer)

    async def remove_target(self, target: int) -> None:
        """Stop tracking a target."""
        await self._client.call("DELETE", f"{self._path}/targets/{target}")

    @overload
    async def trajectory(
        self, format: Literal["json"] = "json", *, after: int | None = None, target: int | None = None
    ) -> list[Result]: ...

    @overload
    async def trajectory(
        self, format: Literal["csv", "otb", "mot"], *, after: int | None = None, target: int | None = None
    ) -> str: ...

    async def trajectory(
        self,
        format: Literal["json", "csv", "otb", "mot"] = "json",
        *,
        after: int | None = None,
        target: int | None = None,
    ) -> list[Result] | str:
        """Return all results so far, or those after a ``seq``: as results, or as text in one of the other formats."""
        params = {"format": format, "after": after, "target": target}
        params = {name: value for name, value in params.items() if value is not None}
        answer = await self._client.call("GET", f"{self._path}/trajectory", params=params)
        if format != "json":
            return answer.text
        return [read_past_result(result) for result in answer.json()["results"]]

    async def snapshot(self) -> bytes:
        """Return the session's whole state, for :meth:`AsyncClient.restore`."""
        return (await self._client.call("GET", f"{self._path}/snapshot")).content

    async def ticket(self, ttl_s: float | None = None) -> Ticket:
        """Return a ticket that admits one handshake of a browser to this session, within ``ttl_s`` seconds."""
        body = {} if ttl_s is None else {"ttl_s": ttl_s}
        return read_answer(Ticket, await self._client.json("POST", f"{self._path}/ticket", json=body))

    def stream(
        self,
        frames: AsyncIterable[T] | Iterable[T] | None = None,
        *,
        mode: Mode = "latest",
        encode: Callable[[T, Region | None], bytes] | None = None,
        on_refused: Callable[[Problem], None] | None = None,
        on_resumed: Callable[[Resumed], None] | None = None,
        takeover: bool = False,
        ticket: str | None = None,
        protocol: Protocol = "mfcmt.v1.msgpack",
        reconnect_for_s: float = 60.0,
    ) -> AsyncStream[T]:
        """Send ``frames`` and return a stream to iterate over their results; see :class:`AsyncStream`.

        Parameters
        ----------
        frames
            Encoded images, paths or :class:`Frame`; with ``encode`` anything. None: frames are given to ``send``.
        mode
            ``latest`` drops frames that newer ones overtake; ``lossless`` answers every one, and sends no faster.
        encode
            ``encode(image, region)`` is called in a thread with each of ``frames`` and the part that is needed (None
            for the whole). It returns that part as an encoded image, which pays where bandwidth or decoding is dear.
        on_refused
            Called with the problem of each refused frame, which is raised out of the iteration otherwise.
        on_resumed
            Called when the stream goes on after a break.
        takeover
            End another stream of the session.
        ticket
            Admits the first handshake, in place of the key.
        protocol
            The subprotocol.
        reconnect_for_s
            How long a broken connection is tried again, in seconds: also through a restart of the service, and while
            others that do not know the session stand in for it.
        """
        connector = Connector(self._client.address, self.id, mode, protocol, takeover, ticket, reconnect_for_s)

        async def missed(after: int) -> list[Result]:
            return await self.trajectory(after=after)

        async def settle() -> None:
            await self._client.settle(self.id)

        return self._client._attached(AsyncStream(connector, frames, encode, on_refused, on_resumed, missed, settle))
