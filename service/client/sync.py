"""The same client for code without asyncio: its event loop runs in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine, Iterable, Iterator
from typing import Any, Generic, Literal, Self, TypeVar, overload

from .aio import AsyncClient
from .session import AsyncSession
from .stream import AsyncStream
from .types import Frame, Image, Ready, Region, Result, SessionInfo, TargetChange, Targets, Ticket

R = TypeVar("R")
T = TypeVar("T")


class _Loop:
    """An event loop in a daemon thread."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="mfcmt-client", daemon=True)
        self._thread.start()

    def run(self, work: Coroutine[Any, Any, R]) -> R:
        """The result of ``work``; it is cancelled when the waiting is interrupted."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class Client:
    """A client of one service; see :class:`AsyncClient`, whose calls it has without ``await``."""

    def __init__(self, url: str = "http://127.0.0.1:8000", **options: Any) -> None:
        self._client = AsyncClient(url, **options)
        self._loop = _Loop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close what is open. Sessions live on until they are closed or time out."""
        self._loop.run(self._client.aclose())
        self._loop.stop()

    def create(
        self,
        frame: Image,
        box: Iterable[float] | None = None,
        *,
        boxes: Iterable[Iterable[float]] | None = None,
        **options: Any,
    ) -> Session:
        """See :meth:`AsyncClient.create`."""
        return Session(self._loop, self._loop.run(self._client.create(frame, box, boxes=boxes, **options)))

    def restore(self, snapshot: Image, **options: Any) -> Session:
        """See :meth:`AsyncClient.restore`."""
        return Session(self._loop, self._loop.run(self._client.restore(snapshot, **options)))

    def session(self, session_id: str) -> Session:
        """See :meth:`AsyncClient.session`."""
        return Session(self._loop, self._loop.run(self._client.session(session_id)))

    def sessions(self) -> list[SessionInfo]:
        """See :meth:`AsyncClient.sessions`."""

        async def all_of_them() -> list[SessionInfo]:
            return [info async for info in self._client.sessions()]

        return self._loop.run(all_of_them())

    def capabilities(self) -> dict[str, Any]:
        """See :meth:`AsyncClient.capabilities`."""
        return self._loop.run(self._client.capabilities())


class Session:
    """One session; ``with`` closes it at the end. See :class:`AsyncSession`."""

    def __init__(self, loop: _Loop, session: AsyncSession) -> None:
        self._loop = loop
        self._session = session

    @property
    def id(self) -> str:
        return self._session.id

    @property
    def info(self) -> SessionInfo:
        return self._session.info

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def refresh(self) -> SessionInfo:
        """See :meth:`AsyncSession.refresh`."""
        return self._loop.run(self._session.refresh())

    def close(self) -> None:
        """See :meth:`AsyncSession.close`."""
        self._loop.run(self._session.close())

    def track(self, frame: Image | Frame) -> Result:
        """See :meth:`AsyncSession.track`."""
        return self._loop.run(self._session.track(frame))

    def add_target(self, box: Iterable[float]) -> TargetChange:
        """See :meth:`AsyncSession.add_target`."""
        return self._loop.run(self._session.add_target(box))

    def correct_target(self, target: int, box: Iterable[float]) -> TargetChange:
        """See :meth:`AsyncSession.correct_target`."""
        return self._loop.run(self._session.correct_target(target, box))

    def remove_target(self, target: int) -> None:
        """See :meth:`AsyncSession.remove_target`."""
        self._loop.run(self._session.remove_target(target))

    @overload
    def trajectory(
        self, format: Literal["json"] = "json", *, after: int | None = None, target: int | None = None
    ) -> list[Result]: ...

    @overload
    def trajectory(
        self, format: Literal["csv", "otb", "mot"], *, after: int | None = None, target: int | None = None
    ) -> str: ...

    def trajectory(
        self,
        format: Literal["json", "csv", "otb", "mot"] = "json",
        *,
        after: int | None = None,
        target: int | None = None,
    ) -> list[Result] | str:
        """See :meth:`AsyncSession.trajectory`."""
        if format == "json":
            return self._loop.run(self._session.trajectory(after=after, target=target))
        return self._loop.run(self._session.trajectory(format, after=after, target=target))

    def snapshot(self) -> bytes:
        """See :meth:`AsyncSession.snapshot`."""
        return self._loop.run(self._session.snapshot())

    def ticket(self, ttl_s: float | None = None) -> Ticket:
        """See :meth:`AsyncSession.ticket`."""
        return self._loop.run(self._session.ticket(ttl_s))

    def stream(self, frames: Iterable[T] | None = None, **options: Any) -> Stream[T]:
        """See :meth:`AsyncSession.stream`; lazy ``frames`` are read in another thread."""
        return Stream(self._loop, self._session.stream(frames, **options))


class Stream(Generic[T]):
    """An iterable of results; see :class:`AsyncStream`."""

    def __init__(self, loop: _Loop, stream: AsyncStream[T]) -> None:
        self._loop = loop
        self._stream = stream

    @property
    def ready(self) -> Ready:
        return self._stream.ready

    @property
    def region(self) -> Region | None:
        return self._stream.region

    def __enter__(self) -> Self:
        self._loop.run(self._stream.__aenter__())
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self._stream.leave()

    def __iter__(self) -> Iterator[Result]:
        try:
            while True:
                try:
                    result = self._loop.run(self._stream.__anext__())
                except StopAsyncIteration:
                    return
                yield result
        finally:
            self._stream.leave()

    def __next__(self) -> Result:
        try:
            return self._loop.run(self._stream.__anext__())
        except StopAsyncIteration:
            raise StopIteration from None

    def send(self, frame: Image | Frame) -> int:
        """See :meth:`AsyncStream.send`."""
        return self._loop.run(self._stream.send(frame))

    def finish(self) -> None:
        """See :meth:`AsyncStream.finish`."""
        self._loop.run(self._stream.finish())

    def add(self, box: Iterable[float], *, on_next: bool = False) -> Targets:
        """See :meth:`AsyncStream.add`."""
        return self._loop.run(self._stream.add(box, on_next=on_next))

    def correct(self, target: int, box: Iterable[float], *, on_next: bool = False) -> Targets:
        """See :meth:`AsyncStream.correct`."""
        return self._loop.run(self._stream.correct(target, box, on_next=on_next))

    def remove(self, target: int) -> Targets:
        """See :meth:`AsyncStream.remove`."""
        return self._loop.run(self._stream.remove(target))

    def close(self) -> None:
        """See :meth:`AsyncStream.aclose`."""
        self._loop.run(self._stream.aclose())
