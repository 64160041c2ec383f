"""One session as the asyncio client sees it."""

from __future__ import annotations

from collections.abc import AsyncIterable, Callable, Iterable
from typing import TYPE_CHECKING, Literal, Self, TypeVar, overload

import msgpack

from .connect import Connector
from .connection import Protocol
from .errors import Problem
from .sources import as_frame, numbers
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

if TYPE_CHECKING:
    from .aio import AsyncClient

T = TypeVar("T")
MSGPACK = "application/msgpack"


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
        connector = Connector(self._client.places, self.id, mode, protocol, takeover, ticket, reconnect_for_s)

        async def missed(after: int) -> list[Result]:
            return await self.trajectory(after=after)

        async def settle() -> None:
            await self._client.settle(self.id)

        return self._client.remember(AsyncStream(connector, frames, encode, on_refused, on_resumed, missed, settle))
