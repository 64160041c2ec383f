"""A stream of frames and results that outlives its connections."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable, Iterable
from contextlib import suppress
from typing import Any, Generic, Self, TypeVar

from ..protocol.enums import ProblemCode
from .connect import Connector
from .connection import Connection
from .controls import PendingControls
from .errors import ClientError, ConnectionLost, Problem
from .sending import FrameSender
from .sources import as_frame, numbers
from .types import Draining, Frame, Image, Ready, Region, Result, Resumed, Targets

T = TypeVar("T")

log = logging.getLogger("mfcmt.client")

# In `latest` a superseded frame is counted by the next result only; where the last frame was refused there may be
# none, so the end waits this long for it.
LINGER_S = 2.0
NOT_DRAINING = Draining(0.0, True)


class AsyncStream(Generic[T]):
    """An async iterator of results; made by :meth:`AsyncSession.stream`.

    Iterating starts it and ends with the last frame's answer. Leaving the loop early, by ``break`` or by an
    exception, ends the attachment; inside ``async with`` the end of the block does, and the loop may be entered
    again. Code that calls ``anext`` closes the stream with :meth:`aclose`.

    A frame that was refused is raised out of the iteration as a :class:`Problem`, unless ``on_refused`` takes it;
    the stream goes on either way. When it goes on after a break of its connection or a restart of the service,
    ``on_resumed`` is called; without it, a loss is logged as a warning.
    """

    def __init__(
        self,
        connector: Connector,
        frames: AsyncIterable[T] | Iterable[T] | None,
        encode: Callable[[T, Region | None], bytes] | None,
        on_refused: Callable[[Problem], None] | None,
        on_resumed: Callable[[Resumed], None] | None,
        missed: Callable[[int], Awaitable[list[Result]]],
        settle: Callable[[], Awaitable[None]],
    ) -> None:
        self._connector = connector
        self._frames = frames
        self._on_refused = on_refused
        self._on_resumed = on_resumed or _log_loss
        self._missed = missed
        self._settle = settle
        self._arrived: asyncio.Queue[Result | ClientError | None] = asyncio.Queue()
        self._sender: FrameSender[T] = FrameSender(connector.mode == "latest", encode, self._arrived.qsize)
        self._controls = PendingControls()
        self._connection: Connection | None = None
        self._ready: Ready | None = None
        self._draining = NOT_DRAINING
        self._last_seq = 0
        self._starting, self._closing = asyncio.Lock(), asyncio.Lock()
        self._ended: ClientError | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._in_block = False
        self._closer: asyncio.Task[None] | None = None
        self.left = False
        """Whether its loop was left early: it closes, or has closed."""

    @property
    def ready(self) -> Ready:
        """What the service said on attaching."""
        if self._ready is None:
            raise ConnectionLost("the stream has not started")
        return self._ready

    @property
    def region(self) -> Region | None:
        """The part of the coming frames that is needed, as the service said last; None for the whole."""
        return self._sender.region

    @property
    def session_id(self) -> str:
        """The id of the session that it belongs to."""
        return self._connector.session_id

    async def __aenter__(self) -> Self:
        self._in_block = True
        await self._start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()

    def __aiter__(self) -> AsyncIterator[Result]:
        return _Iteration(self)

    async def __anext__(self) -> Result:
        await self._start()
        item = await self._arrived.get()
        self._sender.look_again()
        if isinstance(item, Result):
            return item
        if item is None:
            self._arrived.put_nowait(None)
        if item is None or item is self._ended:
            await self.aclose()
        raise item or StopAsyncIteration

    async def send(self, frame: Image | Frame) -> int:
        """Send one frame when there is credit for it, and return its ``seq``. For streams made without frames."""
        ready = await as_frame(frame)
        await self._start()
        return await self._sender.send(ready)

    async def finish(self) -> None:
        """Send no more frames: the iteration ends with the answers to those that were sent."""
        self._exhaust()

    async def add(self, box: Iterable[float], *, on_next: bool = False) -> Targets:
        """Add a target on the newest frame, or on the next one. Raises :class:`Problem`."""
        return await self._control({"type": "add", "box": numbers(box)}, on_next)

    async def correct(self, target: int, box: Iterable[float], *, on_next: bool = False) -> Targets:
        """Put a target right on the newest frame, or on the next one. Raises :class:`Problem`."""
        return await self._control({"type": "correct", "target": target, "box": numbers(box)}, on_next)

    async def remove(self, target: int) -> Targets:
        """Remove a target. Raises :class:`Problem`."""
        return await self._control({"type": "remove", "target": target}, False)

    async def aclose(self) -> None:
        """End the attachment; the session lives on."""
        self._end(None)
        async with self._closing:
            tasks = [task for task in self._tasks if task is not asyncio.current_task()]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            connection, self._connection = self._connection, None
            if connection is not None:
                await connection.close()

    def leave(self) -> None:
        """Close soon, unless a block will; may be called from any thread, also when the event loop is gone."""
        if self._in_block or self._loop is None or self._connection is None:
            return
        self.left = True
        with suppress(RuntimeError):  # the loop is closed, and so is all that it had open
            self._loop.call_soon_threadsafe(self._close_soon)

    def _close_soon(self) -> None:
        self._closer = asyncio.get_running_loop().create_task(self.aclose())

    async def _start(self) -> None:
        async with self._starting:
            if self._tasks or self._ended:
                return
            await self._settle()
            connection, ready = await self._connector.open()
            self._loop = asyncio.get_running_loop()
            self._connection, self._ready, self._last_seq = connection, ready, ready.session.seq
            await self._sender.attach(connection, ready)
            self._tasks = [asyncio.create_task(self._run(connection))]
            if self._frames is not None:
                self._tasks.append(asyncio.create_task(self._pump(self._frames)))

    async def _run(self, connection: Connection) -> None:
        """Receive, and attach again whenever the connection breaks."""
        try:
            while True:
                try:
                    while True:
                        self._dispatch(await connection.receive())
                except ConnectionLost as lost:
                    self._sender.detach()
                    self._controls.fail(lost)
                connection = await self._resume()
        except ClientError as end:
            self._end(end)
        except Exception as broken:
            self._end(ClientError(f"what the server said cannot be read: {broken!r}"), broken)

    async def _pump(self, frames: AsyncIterable[T] | Iterable[T]) -> None:
        try:
            await self._sender.pump(frames, self._exhaust)
        except ClientError as end:
            self._end(end)
        except Exception as broken:
            self._end(ClientError(f"the frames broke off: {broken!r}"), broken)

    async def _resume(self) -> Connection:
        """Return a new connection on which the stream goes on. Raises what forbids it."""
        broken = time.monotonic()
        draining, self._draining = self._draining, NOT_DRAINING
        connection = await self._connector.reopen(self.ready, draining, self._take_up)
        ready = self.ready
        lost_after = ready.lost_after if (ready.lost_after or 0) < self._last_seq else None
        self._on_resumed(Resumed(ready.session.seq, time.monotonic() - broken, lost_after))
        return connection

    async def _take_up(self, connection: Connection, ready: Ready) -> None:
        """Fetch the results that were missed, and send again what was not tracked."""
        self._connection, self._ready = connection, ready
        if self._sender.has_unanswered_up_to(ready.session.seq):
            for result in await self._missed(self._last_seq):
                self._dispatch(result)
        await self._sender.attach(connection, ready)
        self._end_if_done()

    async def _control(self, control: dict[str, Any], on_next: bool) -> Targets:
        await self._start()
        connection = await self._sender.connected()
        ref, answer = self._controls.add()
        await connection.send_control(control | {"ref": ref} | ({"on": "next"} if on_next else {}))
        return await answer

    def _dispatch(self, message: object) -> None:
        match message:
            case Result():
                self._last_seq = max(self._last_seq, message.seq)
                self._sender.answered(message)
                self._arrived.put_nowait(message)
            case Problem():
                self._refuse(message)
            case Targets():
                self._sender.region = message.region
                self._controls.answer(message)
            case Draining():
                self._draining = message
        self._sender.look_again()
        self._end_if_done()

    def _refuse(self, problem: Problem) -> None:
        if self._controls.refuse(problem):
            if problem.code == ProblemCode.FULL_FRAME_NEEDED:
                self._sender.region = problem.region
        elif self._sender.refused(problem):
            pass
        elif self._on_refused is not None:
            self._on_refused(problem)
        else:
            self._arrived.put_nowait(problem)

    def _exhaust(self) -> None:
        self._sender.exhausted = True
        self._end_if_done()

    def _end_if_done(self) -> None:
        if self._sender.idle:
            self._end(None)
        elif self._sender.last_may_be_superseded:
            asyncio.get_running_loop().call_later(LINGER_S, self._end, None)

    def _end(self, why: ClientError | None, cause: BaseException | None = None) -> None:
        if self._ended is not None:
            return
        self._ended = why or ConnectionLost("the stream has ended")
        if why is not None:
            why.__cause__ = why.__cause__ or cause
            self._arrived.put_nowait(why)
        self._arrived.put_nowait(None)
        self._controls.fail(ConnectionLost("the stream has ended"))
        self._sender.end(self._ended)


class _Iteration:
    """The results of one ``async for``, which nothing refers to any more once it is left."""

    def __init__(self, stream: AsyncStream[Any]) -> None:
        self._stream = stream

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Result:
        return await self._stream.__anext__()

    def __del__(self) -> None:
        self._stream.leave()


def _log_loss(resumed: Resumed) -> None:
    if resumed.lost_after is not None:
        log.warning("the service broke down: what it learned after frame %d is lost", resumed.lost_after)
