"""Sends the frames of a stream: within the credit, cut to what is needed, and again after a break."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterable, Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Generic, TypeVar, cast

from ..protocol.enums import ProblemCode
from .connection import Connection
from .errors import ClientError, Problem
from .sources import as_frame, each, image_bytes
from .types import Frame, Image, Ready, Region, Result

T = TypeVar("T")

# Results that may wait unread before no more frames are sent.
MAX_UNREAD = 64


class FrameSender(Generic[T]):
    """Numbers frames, sends them when there is room, and remembers them until they are answered.

    Parameters
    ----------
    latest
        Whether the stream's mode is ``latest``, where the service may supersede a frame without an answer.
    encode
        Makes an image of what ``pump`` takes from its source, or of the part that is needed.
    unread
        Returns how many results wait to be read.
    """

    def __init__(
        self, latest: bool, encode: Callable[[T, Region | None], bytes] | None, unread: Callable[[], int]
    ) -> None:
        self.region: Region | None = None
        """The part of the coming frames that is needed; None for the whole."""
        self.exhausted = False
        """Whether no more frames will come."""
        self._latest, self._encode, self._unread = latest, encode, unread
        self._ready: Ready | None = None
        self._connection: Connection | None = None
        self._connected = asyncio.Event()
        self._room = asyncio.Event()
        self._unanswered: dict[int, tuple[T | None, Frame]] = {}
        self._again: deque[T] = deque()
        self._next_seq = 0
        self._ended: ClientError | None = None

    @property
    def idle(self) -> bool:
        """Whether no more frames will come and all are answered."""
        return self.exhausted and not self._again and not self._unanswered

    @property
    def last_may_be_superseded(self) -> bool:
        """Whether no more frames will come, and those unanswered may never be, as the last one was refused."""
        return self.exhausted and not self._again and self._latest and self._next_seq - 1 not in self._unanswered

    def has_unanswered_up_to(self, seq: int) -> bool:
        """Whether a frame up to ``seq`` is unanswered."""
        return any(number <= seq for number in self._unanswered)

    async def attach(self, connection: Connection, ready: Ready) -> None:
        """Go on with a new connection; send again what was not tracked, in ``latest`` the newest alone."""
        again = sorted(self._unanswered.items())
        if self._latest:
            again = again[-1:]
        self._unanswered.clear()
        self._next_seq = max(self._next_seq, ready.next_seq)
        for _, (source, frame) in again:
            await self._send(connection, source, replace(frame, seq=None))
        self._connection, self._ready = connection, ready
        self.region = ready.session.region
        self._connected.set()
        self._room.set()

    def detach(self) -> None:
        """Wait for another connection."""
        self._connected.clear()

    async def connected(self) -> Connection:
        """Return the connection, as soon as there is one. Raises what ended the stream."""
        await self._connected.wait()
        if self._ended is not None:
            raise self._ended
        assert self._connection is not None
        return self._connection

    async def send(self, frame: Frame) -> int:
        """Send a frame when there is room and return its number."""
        await self._wait_for_room()
        return await self._send(await self.connected(), None, frame)

    async def pump(self, frames: AsyncIterable[T] | Iterable[T], on_exhausted: Callable[[], None]) -> None:
        """Send all ``frames`` and call ``on_exhausted`` after the last; goes on for those that must be sent again."""
        source = each(frames)
        while True:
            await self._wait_for_room()
            if self._again:
                item, region = self._again.popleft(), None
            elif self.exhausted:
                return
            else:
                try:
                    item = await anext(source)
                except StopAsyncIteration:
                    on_exhausted()
                    continue
                region = self.region
            frame = await self._encoded(item, region)
            await self._send(await self.connected(), item, frame)

    def answered(self, result: Result) -> None:
        """Forget the frame of ``result``, in ``latest`` also those that it superseded."""
        self.region = result.region
        if self._latest:
            for seq in [seq for seq in self._unanswered if seq <= result.seq]:
                del self._unanswered[seq]
        else:
            self._unanswered.pop(result.seq, None)

    def refused(self, problem: Problem) -> bool:
        """Forget a refused frame; True if nobody else has to know, because a larger part is sent in its place."""
        source = None
        if problem.seq is not None:
            source, _ = self._unanswered.pop(problem.seq, (None, None))
        if problem.code != ProblemCode.BAD_REGION or self._encode is None:
            return False
        self.region = problem.region
        if not self._latest and source is not None:
            self._again.append(source)
        return True

    def look_again(self) -> None:
        """Something may have made room."""
        self._room.set()

    def end(self, why: ClientError) -> None:
        """Let everything that waits raise ``why``."""
        self._ended = why
        self._connected.set()
        self._room.set()

    async def _encoded(self, item: T, region: Region | None) -> Frame:
        if self._encode is None:
            return await as_frame(cast(Image | Frame, item))
        assert self._ready is not None
        if region is not None and tuple(region) == (0, 0, *self._ready.session.size):
            region = None
        encoded = await asyncio.to_thread(self._encode, item, region)
        return Frame(await image_bytes(encoded, "what encode returns"), region=region)

    async def _wait_for_room(self) -> None:
        while self._ended is None and not self._has_room():
            self._room.clear()
            await self._room.wait()

    def _has_room(self) -> bool:
        if self.exhausted and not self._again:
            return not self._unanswered
        credit = None if self._ready is None else self._ready.credit
        if credit is not None and self._encode is not None:
            credit = 1  # a cut surely covers what is needed only when the frame before it is answered
        return (credit is None or len(self._unanswered) < credit) and self._unread() < MAX_UNREAD

    async def _send(self, connection: Connection, source: T | None, frame: Frame) -> int:
        seq = self._next_seq if frame.seq is None else frame.seq
        self._next_seq = seq + 1
        frame = replace(frame, seq=seq)
        self._unanswered[seq] = source, frame
        with suppress(ClientError):  # the receiver notices it too, and ends the stream or sends the frame again
            await connection.send_frame(frame)
        return seq
