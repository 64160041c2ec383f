"""One lane: a worker process, the socket to it, and the order in which calls enter."""

from __future__ import annotations

import asyncio
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import ForkServerContext, ForkServerProcess
from typing import cast

import msgpack

from ..protocol.enums import LaneLoss
from . import worker
from .fair_queue import FairOwnerQueue
from .framing import HELLO, NO_REPLY, TOOK, FramingError, Splitter, encode_call, framed
from .interface import Buffers, LaneLost
from .limits import LaneLimits

# While the lane works on a short call, the next one is already in its socket, so that it never waits for the front.
PIPELINE = 2
# Behind a long call nothing is sent: which call is next is decided when it is done, and the hand-over costs little in
# comparison. A call counts as long as the longest recent one of its key, in processor time; the first counts as long.
SHORT_S, SHORT_BYTES = 0.01, 512 * 1024
DECAY = 0.7


@dataclass(slots=True)
class PendingCall:
    """A call that waits for its reply."""

    owner: str
    key: str
    request: Buffers
    answer: asyncio.Future[bytes | memoryview]


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
        self._in_flight: deque[tuple[int, PendingCall]] = deque()
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
            self._queue.push(owner, key, PendingCall(owner, key, request, answer))
            self._dispatch()
        return answer

    def forget(self, key: str) -> None:
        """Have the lane drop its state for ``key``, behind the operation in work."""
        self._expected.pop(key, None)
        for call in self._queue.forget(self.keys.pop(key), key):
            _fail(call, LaneLost(LaneLoss.RELEASED))
        if self._transport is not None and not self.lost:
            self._transport.writelines(framed(NO_REPLY, encode_call("drop", key, {})))

    def overdue_s(self) -> float:
        """Return the seconds since the operation in work began, 0 if there is none."""
        return time.monotonic() - self._working_since if self._in_flight else 0.0

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
        # No flow control is needed: PIPELINE bounds what may be in the socket.
        self._transport = cast(asyncio.WriteTransport, transport)

    def data_received(self, data: bytes) -> None:
        """Take the replies of the worker."""
        try:
            for call, payload in self._splitter.feed(data):
                if call == HELLO:
                    self._hello(payload[TOOK.size :])
                else:
                    (took,) = TOOK.unpack_from(payload)
                    self._reply(call, took, payload[TOOK.size :])
        except (FramingError, ValueError, struct.error):
            self.kill()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        """Fail every call: the worker has died or was told to stop."""
        self.lost, self.ready = True, False
        calls = [call for _, call in self._in_flight]
        if calls:
            _fail(calls.pop(0), LaneLost(self._cause, in_work=True))
        for key, owner in self.keys.items():
            calls += self._queue.forget(owner, key)
        for call in calls:
            _fail(call, LaneLost(self._cause))
        self._in_flight.clear()
        self._on_lost(self, self._cause)

    def _hello(self, payload: bytes | memoryview) -> None:
        hello = msgpack.unpackb(payload)
        self.versions, self.confined = hello["versions"], tuple(hello["confined"])
        self.ready = True
        self.since = time.monotonic()
        self._on_ready(self)

    def _reply(self, number: int, took: float, payload: bytes | memoryview) -> None:
        if not self._in_flight or self._in_flight[0][0] != number:
            raise FramingError("a reply is out of order")
        _, call = self._in_flight.popleft()
        now = time.monotonic()
        used = now - self._working_since
        self._working_since = now
        if call.key in self.keys:
            self._expected[call.key] = max(took, DECAY * self._expected.get(call.key, 0.0))
            self._on_used(call.key, used)
        self._queue.charge(call.owner, call.key, used)
        if not call.answer.done():
            call.answer.set_result(payload)
        self._dispatch()

    def _dispatch(self) -> None:
        assert self._transport is not None
        while self._takes_more() and (call := self._queue.pop()) is not None:
            if call.answer.done():
                continue
            if not self._in_flight:
                self._working_since = time.monotonic()
            self._calls = self._calls % 0xFFFFFFFF + 1
            self._in_flight.append((self._calls, call))
            self._transport.writelines(framed(self._calls, call.request))

    def _takes_more(self) -> bool:
        """Return whether another call may be sent: the lane is idle, or works on a call that will be short."""
        if not self._in_flight:
            return True
        _, call = self._in_flight[-1]
        return (
            len(self._in_flight) < PIPELINE
            and self._expected.get(call.key, SHORT_S) < SHORT_S
            and len(call.request[-1]) <= SHORT_BYTES
        )


def _fail(call: PendingCall, error: Exception) -> None:
    if not call.answer.done():
        call.answer.set_exception(error)
