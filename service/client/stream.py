"""A stream of frames and results that outlives its connections."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any, Generic, Self, TypeVar, cast

from .attach import Attachment
from .connection import Connection
from .errors import ClientError, ConnectionLost, Problem
from .sources import as_frame, each, image_bytes, numbers
from .types import Draining, Frame, Image, Ready, Region, Result, Resumed, Targets

T = TypeVar("T")

log = logging.getLogger("mfcmt.client")

# Results that may wait unread before no more frames are sent.
MAX_UNREAD = 64
# In `latest` a superseded frame is told by the next result only; where the last frame was refused there may
# be none, so the end waits this long for it.
LINGER_S = 2.0


class AsyncStream(Generic[T]):
    """An async iterator of results; made by :meth:`AsyncSession.stream`.

    Iterating starts it and ends with the last frame's answer. Leaving the loop early, by ``break`` or by an
    exception, ends the attachment; inside ``async with`` the end of the block does, and the loop may be entered
    again. Who calls ``anext`` instead closes the stream with :meth:`aclose`.

    A frame that was refused is raised out of the iteration as a :class:`Problem`, unless ``on_refused`` takes it;
    the stream goes on either way. When it goes on after a break of its connection or a restart of the service,
    ``on_resumed`` is told; without it, a loss is logged as a warning.
    """

    def __init__(
        self,
        attachment: Attachment,
        frames: AsyncIterable[T] | Iterable[T] | None,
        encode: Callable[[T, Region | None], bytes] | None,
        on_refused: Callable[[Problem], None] | None,
        on_resumed: Callable[[Resumed], None] | None,
        missed: Callable[[int], Awaitable[list[Result]]],
        settle: Callable[[], Awaitable[None]],
    ) -> None:
        self._attachment = attachment
        self._latest = attachment.mode == "latest"
        self._frames = frames
        self._encode = encode
        self._on_refused = on_refused
        self._on_resumed = on_resumed or _log_loss
        self._missed = missed
        self._settle = settle
        self._connection: Connection | None = None
        self._ready: Ready | None = None
        self._starting, self._closing = asyncio.Lock(), asyncio.Lock()
        self._up = asyncio.Event()
        self._room = asyncio.Event()
        self._arrived: asyncio.Queue[Result | ClientError | None] = asyncio.Queue()
        self._unanswered: dict[int, tuple[T | None, Frame]] = {}
        self._again: deque[T] = deque()
        self._controls: dict[int, asyncio.Future[Targets]] = {}
        self._refs = 0
        self._next_seq = 0
        self._last_seq = 0
        self._exhausted = False
        self._ended: ClientError | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._in_block = False
        self._closer: asyncio.Task[None] | None = None
        self.left = False
        """Whether its loop was left early: it closes, or has closed."""
        self._told = Draining(0.0, True)
        self.region: Region | None = None
        """The part of the coming frames that is needed, as last told; None for the whole."""

    @property
    def ready(self) -> Ready:
        """What the server said on attaching."""
        if self._ready is None:
            raise ConnectionLost("the stream has not started")
        return self._ready

    @property
    def session_id(self) -> str:
        """The id of the session that it belongs to."""
        return self._attachment.session_id

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
        self._room.set()
        if isinstance(item, Result):
            return item
        if item is None:
            self._arrived.put_nowait(None)
        if item is None or item is self._ended:
            await self.aclose()
        raise item or StopAsyncIteration

    async def send(self, frame: Image | Frame) -> int:
        """Send one frame when there is credit for it; its ``seq``. For streams made without frames."""
        ready = await as_frame(frame)
        await self._start()
        await self._wait_for_room()
        return await self._send(None, ready)

    async def finish(self) -> None:
        """No more frames will be sent: the iteration ends with the answers to those that were."""
        self._exhausted = True
        self._end_if_done()

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
            connection, ready = await self._attachment.open()
            self._loop = asyncio.get_running_loop()
            self._connection, self._ready = connection, ready
            self._next_seq, self._last_seq = ready.next_seq, ready.session.seq
            self._stand(ready)
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
                    self._fall(lost)
                connection = await self._resume()
        except ClientError as end:
            self._end(end)
        except Exception as broken:
            self._end(ClientError(f"what the server said cannot be read: {broken!r}"), broken)

    async def _resume(self) -> Connection:
        """A new connection on which the stream goes on; raises what forbids it."""
        broken = time.monotonic()
        told, self._told = self._told, Draining(0.0, True)
        connection = await self._attachment.reopen(self.ready, told, self._take_up)
        ready = self.ready
        lost_after = ready.lost_after if (ready.lost_after or 0) < self._last_seq else None
        self._on_resumed(Resumed(ready.session.seq, time.monotonic() - broken, lost_after))
        return connection

    async def _take_up(self, connection: Connection, ready: Ready) -> None:
        """Fetch the results that were missed, send again what was not tracked."""
        self._connection, self._ready = connection, ready
        if any(seq <= ready.session.seq for seq in self._unanswered):
            for result in await self._missed(self._last_seq):
                self._dispatch(result)
        again = sorted(self._unanswered.items())
        if self._latest:
            again = again[-1:]
        self._unanswered.clear()
        self._next_seq = max(self._next_seq, ready.next_seq)
        for _, (source, frame) in again:
            await self._send_on(connection, source, replace(frame, seq=None))
        self._stand(ready)
        self._end_if_done()

    def _stand(self, ready: Ready) -> None:
        self.region = ready.session.region
        self._up.set()
        self._room.set()

    def _fall(self, lost: ConnectionLost) -> None:
        self._up.clear()
        for future in self._controls.values():
            if not future.done():
                future.set_exception(lost)
        self._controls.clear()

    async def _pump(self, frames: AsyncIterable[T] | Iterable[T]) -> None:
        source = each(frames)
        try:
            while True:
                await self._wait_for_room()
                if self._again:
                    item, region = self._again.popleft(), None
                elif self._exhausted:
                    return
                else:
                    try:
                        item = await anext(source)
                    except StopAsyncIteration:
                        await self.finish()
                        continue
                    region = self.region
                await self._send(item, await self._encoded(item, region))
        except ClientError as end:
            self._end(end)
        except Exception as broken:
            self._end(ClientError(f"the frames broke off: {broken!r}"), broken)

    async def _encoded(self, item: T, region: Region | None) -> Frame:
        if self._encode is None:
            return await as_frame(cast(Image | Frame, item))
        if region is not None and tuple(region) == (0, 0, *self.ready.session.size):
            region = None
        encoded = await asyncio.to_thread(self._encode, item, region)
        return Frame(await image_bytes(encoded, "what encode returns"), region=region)

    async def _wait_for_room(self) -> None:
        while self._ended is None and not self._has_room():
            self._room.clear()
            await self._room.wait()

    def _has_room(self) -> bool:
        if self._exhausted and not self._again:
            return not self._unanswered
        credit = self.ready.credit
        if credit is not None and self._encode is not None:
            credit = 1  # a cut is sure to cover what is needed only when the frame before it is answered
        return (credit is None or len(self._unanswered) < credit) and self._arrived.qsize() < MAX_UNREAD

    async def _connected(self) -> Connection:
        await self._up.wait()
        if self._ended is not None:
            raise self._ended
        assert self._connection is not None
        return self._connection

    async def _send(self, source: T | None, frame: Frame) -> int:
        return await self._send_on(await self._connected(), source, frame)

    async def _send_on(self, connection: Connection, source: T | None, frame: Frame) -> int:
        seq = self._next_seq if frame.seq is None else frame.seq
        self._next_seq = seq + 1
        frame = replace(frame, seq=seq)
        self._unanswered[seq] = source, frame
        with suppress(ClientError):  # the receiver sees it too and ends the stream or sends the frame again
            await connection.send_frame(frame)
        return seq

    async def _control(self, control: dict[str, Any], on_next: bool) -> Targets:
        await self._start()
        connection = await self._connected()
        self._refs += 1
        ref = self._refs
        answer = self._controls[ref] = asyncio.get_running_loop().create_future()
        await connection.send_control(control | {"ref": ref} | ({"on": "next"} if on_next else {}))
        done: Targets = await answer
        return done

    def _dispatch(self, message: object) -> None:
        match message:
            case Result():
                self._last_seq = max(self._last_seq, message.seq)
                self.region = message.region
                if self._latest:
                    for seq in [seq for seq in self._unanswered if seq <= message.seq]:
                        del self._unanswered[seq]
                else:
                    self._unanswered.pop(message.seq, None)
                self._arrived.put_nowait(message)
            case Problem(ref=int(ref)) if ref in self._controls:
                self._controls.pop(ref).set_exception(message)
                if message.code == "full-frame-needed":
                    self.region = message.region
            case Problem():
                self._refuse(message)
            case Targets(ref=ref):
                self.region = message.region
                if ref in self._controls:
                    self._controls.pop(ref).set_result(message)
            case Draining():
                self._told = message
        self._room.set()
        self._end_if_done()

    def _refuse(self, problem: Problem) -> None:
        source, _ = self._unanswered.pop(problem.seq, (None, None)) if problem.seq is not None else (None, None)
        if problem.code == "bad-region" and self._encode is not None:
            self.region = problem.region
            if not self._latest and source is not None:
                self._again.append(source)
        elif self._on_refused is not None:
            self._on_refused(problem)
        else:
            self._arrived.put_nowait(problem)

    def _end_if_done(self) -> None:
        if not self._exhausted or self._again:
            return
        if not self._unanswered:
            self._end(None)
        elif self._latest and self._next_seq - 1 not in self._unanswered:
            asyncio.get_running_loop().call_later(LINGER_S, self._end, None)

    def _end(self, why: ClientError | None, cause: BaseException | None = None) -> None:
        if self._ended is not None:
            return
        self._ended = why or ConnectionLost("the stream has ended")
        if why is not None:
            why.__cause__ = why.__cause__ or cause
            self._arrived.put_nowait(why)
        self._arrived.put_nowait(None)
        self._fall(ConnectionLost("the stream has ended"))
        self._up.set()
        self._room.set()


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
