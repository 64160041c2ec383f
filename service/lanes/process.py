"""One lane: a worker process, the socket to it, and the order in which calls enter."""

from __future__ import annotations

import asyncio
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from multiprocessing.context import ForkServerContext, ForkServerProcess
from typing import cast

import msgpack

from ..landing import Landing
from ..protocol.enums import LaneLoss
from . import worker
from .fair_queue import FairOwnerQueue
from .framing import (
    HELLO,
    NO_REPLY,
    PART,
    PART_BYTES,
    TOOK,
    FramingError,
    Splitter,
    begin_parts,
    encode_call,
    framed,
    is_large,
)
from .interface import Buffers, LaneLost
from .large_calls import LargeCalls, PendingCall
from .limits import LaneLimits

# While the lane works on a short call, the next one is already in its socket, so that it never waits for the front.
PIPELINE = 2
# Behind a long call nothing is sent: which call is next is decided when it is done, and the hand-over costs little in
# comparison. A call counts as long as the longest recent one of its key, in processor time; the first counts as long.
SHORT_S = 0.01
# A lane moves as much of a large reply between two operations; the system may allow less.
SOCKET_BYTES = 2 << 20
DECAY = 0.7


class LaneProcess(asyncio.Protocol):
    """A worker process from its start to its end. It is never restarted, only replaced."""

    def __init__(
        self,
        number: int,
        *,
        on_ready: Callable[[LaneProcess], None],
        on_lost: Callable[[LaneProcess, LaneLoss], None],
        on_used: Callable[[str, float], None],
    ) -> None:
        self.number = number
        self.keys: dict[str, str] = {}  # with their owners
        self.ready = False
        self.lost = False
        self.versions: dict[str, str] = {}
        self.confined: tuple[str, ...] = ()
        self.since = time.monotonic()
        self._on_ready = on_ready
        self._on_lost = on_lost
        self._on_used = on_used
        self._queue: FairOwnerQueue[PendingCall] = FairOwnerQueue()
        self._expected: dict[str, float] = {}
        self._in_flight: deque[PendingCall] = deque()
        self._large = LargeCalls(self._send_part, self._enqueue)
        self._arriving: dict[int, tuple[PendingCall, Landing]] = {}  # done, with the parts of the reply so far
        self._working_since = 0.0
        self._cause = LaneLoss.DIED
        self._calls = 0
        self._splitter = Splitter()
        self._transport: asyncio.WriteTransport | None = None
        self._process: ForkServerProcess | None = None

    async def start(self, context: ForkServerContext, limits: LaneLimits) -> None:
        """Fork the worker. The first fork waits for the fork server to load and warm the tracker."""
        self.since = time.monotonic()
        ours, theirs = socket.socketpair()
        for end in (ours, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BYTES)
        with theirs:
            # multiprocessing pickles these arguments for its own child at the start; nothing is pickled later.
            process = context.Process(
                target=worker.main, args=(theirs, limits), name=f"mfcmt-lane-{self.number}", daemon=True
            )
            await asyncio.to_thread(process.start)
        self._process = process
        await asyncio.get_running_loop().create_unix_connection(lambda: self, sock=ours)

    def lasted_s(self) -> float:
        """Return the seconds that the lane has been starting, or ready."""
        return time.monotonic() - self.since

    @property
    def pid(self) -> int | None:
        """The worker's process id."""
        return self._process.pid if self._process else None

    def call(self, key: str, request: Buffers) -> asyncio.Future[bytes | memoryview]:
        """Queue one operation and return the future of its reply; its exception is LaneLost."""
        answer: asyncio.Future[bytes | memoryview] = asyncio.get_running_loop().create_future()
        if self.lost:
            answer.set_exception(LaneLost(self._cause))
        else:
            owner = self.keys[key]
            call = PendingCall(owner, key, request, answer, large=is_large(request))
            (self._large.push if call.large else self._enqueue)(call)
        return answer

    def forget(self, key: str) -> None:
        """Have the lane drop its state for ``key``, behind the operation in work."""
        self._expected.pop(key, None)
        owner = self.keys.pop(key)
        for call in (*self._queue.forget(owner, key), *self._large.of_key(key)):
            call.fail(LaneLost(LaneLoss.RELEASED))
            self._large.take_back(call)
        if self._transport is not None and not self.lost:
            self._transport.writelines(framed(NO_REPLY, encode_call("drop", key, {})))

    def overdue_s(self) -> float:
        """Return the seconds since the operation in work began or a part of a large call moved; 0 without any."""
        if not (self._in_flight or self._large.sends or self._arriving):
            return 0.0
        return time.monotonic() - max(self._working_since, self._large.moved)

    def kill(self, cause: LaneLoss = LaneLoss.DIED) -> None:
        """End the worker at once. The first ``cause`` is the one that is reported."""
        if self._cause is LaneLoss.DIED:
            self._cause = cause
        if self._process is not None and self._process.pid is not None:
            self._process.kill()

    async def stop(self, timeout_s: float) -> None:
        """Let the worker end by itself, or kill it after ``timeout_s``."""
        if self._transport is not None:
            self._transport.close()
        if self._process is not None and self._process.pid is not None:
            await asyncio.to_thread(self._process.join, timeout_s)
            if self._process.is_alive():
                self.kill()
                await asyncio.to_thread(self._process.join, timeout_s)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the socket to write to; the worker will say hello."""
        self._transport = cast(asyncio.WriteTransport, transport)
        self._transport.set_write_buffer_limits(2 * PART_BYTES)

    def pause_writing(self) -> None:
        """The socket is full: further parts wait. Other calls do not, since PIPELINE bounds them."""
        self._large.full = True

    def resume_writing(self) -> None:
        """The socket takes more."""
        self._large.full = False
        self._large.go_on()

    def data_received(self, data: bytes) -> None:
        """Take the replies of the worker."""
        try:
            for call, payload in self._splitter.feed(data):
                if call == HELLO:
                    self._hello(payload[TOOK.size :])
                elif (arriving := self._arriving.get(call & ~PART)) is not None:
                    self._take_part(call, *arriving, payload)
                else:
                    (took,) = TOOK.unpack_from(payload)
                    self._reply(call, took, payload[TOOK.size :])
        except (FramingError, ValueError, struct.error):
            self.kill()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        """Fail every call: the worker has died or was told to stop."""
        self.lost, self.ready = True, False
        if self._in_flight:
            self._in_flight.popleft().fail(LaneLost(self._cause, in_work=True))
        calls = [*self._in_flight, *self._large.clear(), *(call for call, _ in self._arriving.values())]
        for key, owner in self.keys.items():
            calls += self._queue.forget(owner, key)
        for call in calls:
            call.fail(LaneLost(self._cause))
        self._in_flight.clear()
        self._arriving.clear()
        self._on_lost(self, self._cause)

    def _hello(self, payload: bytes | memoryview) -> None:
        hello = msgpack.unpackb(payload)
        self.versions, self.confined = hello["versions"], tuple(hello["confined"])
        self.ready = True
        self.since = time.monotonic()
        self._on_ready(self)

    def _reply(self, number: int, took: float, payload: bytes | memoryview) -> None:
        """Take the reply of the operation in work, or the first part of it."""
        if not self._in_flight or self._in_flight[0].number != number & ~PART:
            raise FramingError("a reply is out of order")
        call = self._in_flight.popleft()
        now = time.monotonic()
        used = now - self._working_since
        self._working_since = now
        if call.key in self.keys:
            self._expected[call.key] = max(took, DECAY * self._expected.get(call.key, 0.0))
            self._on_used(call.key, used)
        self._queue.charge(call.owner, call.key, used)
        if number & PART:
            self._arriving[call.number] = call, begin_parts(payload)
            self._large.moved = now
        else:
            self._answer(call, payload)
        self._dispatch()

    def _take_part(self, number: int, call: PendingCall, landing: Landing, payload: bytes | memoryview) -> None:
        """Take a further part of a reply, or its end."""
        landing.add(payload)
        self._large.moved = time.monotonic()
        if not number & PART:
            del self._arriving[number]
            self._answer(call, landing.taken())

    def _answer(self, call: PendingCall, payload: bytes | memoryview) -> None:
        if not call.answer.done():
            call.answer.set_result(payload)
        if call.large:
            self._large.end(call)

    def _enqueue(self, call: PendingCall) -> None:
        """Queue a call of which there is a little to send."""
        self._queue.push(call.owner, call.key, call)
        self._dispatch()

    def _send_part(self, call: PendingCall, part: Buffers) -> None:
        call.number = call.number or self._next_number()
        if self._transport is not None and not self.lost:
            self._transport.writelines(framed(call.number | PART, part))

    def _next_number(self) -> int:
        self._calls = self._calls % (PART - 1) + 1
        return self._calls

    def _dispatch(self) -> None:
        assert self._transport is not None
        while self._queue.waiting and self._takes_more():
            call = self._queue.pop()
            assert call is not None
            if call.answer.done():
                self._large.take_back(call)
                continue
            if not self._in_flight:
                self._working_since = time.monotonic()
            call.number = call.number or self._next_number()
            self._in_flight.append(call)
            self._transport.writelines(framed(call.number, call.request))

    def _takes_more(self) -> bool:
        """Return whether another call may be sent: the lane is idle, or works on a call that will be short."""
        if not self._in_flight:
            return True
        expected = self._expected.get(self._in_flight[-1].key, SHORT_S)
        return len(self._in_flight) < PIPELINE and expected < SHORT_S
