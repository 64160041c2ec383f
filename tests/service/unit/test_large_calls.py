"""Megabytes on the way to a lane or back: other calls pass them. The lane's end of the wire is a thread here."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from service.lanes.framing import NO_REPLY, decode_call, decode_reply, encode_call, encode_value
from service.lanes.interface import LaneLost
from service.lanes.large_calls import LARGE_OF_OWNER
from service.lanes.process import LaneProcess
from service.lanes.wire import LaneWire
from service.protocol.enums import LaneLoss

MIB = 1 << 20
PATIENCE_S = 20


class Worker(threading.Thread):
    """Answers every call with the length of its data; to ``checkpoint`` with ``state``. ``wire`` is that of a lane."""

    def __init__(self, sock: socket.socket) -> None:
        super().__init__(daemon=True)
        self.wire = LaneWire(sock)
        self.state = b""
        self.heard: list[str] = []
        self.reads = threading.Event()
        self.reads.set()

    def run(self) -> None:
        try:
            while True:
                self.reads.wait()
                call, payload = self.wire.receive()
                op, key, _, data = decode_call(payload)
                self.heard.append(f"{op} {key}")
                if call != NO_REPLY:
                    self.wire.send(call, encode_value(self.state if op == "checkpoint" else len(data)))
        except (EOFError, OSError):
            pass


@asynccontextmanager
async def lane_and_worker() -> AsyncIterator[tuple[LaneProcess, Worker]]:
    """A lane's end in the front, and a worker."""

    def ignore(*_: Any) -> None: ...

    ours, theirs = socket.socketpair()
    lane = LaneProcess(0, on_ready=ignore, on_lost=ignore, on_used=ignore)
    lane.keys = {"big": "one", "also big": "one", "small": "another"}
    worker = Worker(theirs)
    worker.start()
    transport, _ = await asyncio.get_running_loop().create_unix_connection(lambda: lane, sock=ours)
    try:
        async with asyncio.timeout(PATIENCE_S):
            yield lane, worker
    finally:
        transport.close()
        await asyncio.to_thread(worker.join, PATIENCE_S)
        theirs.close()


async def value(answer: asyncio.Future[bytes | memoryview]) -> Any:
    """The value of a reply."""
    code, found = decode_reply(await answer)
    assert code is None
    return found


def track(lane: LaneProcess, key: str, size: int) -> asyncio.Future[bytes | memoryview]:
    return lane.call(key, encode_call("track", key, {}, bytes(size)))


async def test_a_small_call_passes_a_large_one_that_is_being_sent() -> None:
    async with lane_and_worker() as (lane, worker):
        large = track(lane, "big", 16 * MIB)
        small = track(lane, "small", 1000)
        assert await value(small) == 1000
        assert not large.done()
        assert await value(large) == 16 * MIB
        assert worker.heard == ["track small", "track big"]


async def test_a_small_call_passes_a_large_reply_that_is_being_received() -> None:
    async with lane_and_worker() as (lane, worker):
        worker.state = bytes(range(256)) * (16 * MIB // 256)
        large = lane.call("big", encode_call("checkpoint", "big", {}))
        await asyncio.sleep(0)  # the call is in the socket
        small = track(lane, "small", 1000)
        assert await value(small) == 1000
        assert not large.done()
        assert await value(large) == worker.state
        assert worker.heard == ["checkpoint big", "track small"]


@pytest.mark.parametrize("size", [0, 1, 1 << 17, MIB, MIB + 1, MIB + (1 << 17), 3 * MIB + 7])
async def test_every_size_arrives_whole_in_both_directions(size: int) -> None:
    async with lane_and_worker() as (lane, worker):
        worker.state = bytes(range(251)) * (size // 251) + b"x" * (size % 251)
        for _ in range(2):
            assert await value(track(lane, "big", size)) == size
            assert await value(lane.call("big", encode_call("checkpoint", "big", {}))) == worker.state


async def test_only_a_few_large_calls_of_an_owner_are_with_the_lane_at_once() -> None:
    async with lane_and_worker() as (lane, worker):
        worker.reads.clear()
        await value(track(lane, "small", 1))  # was awaited when the worker stopped
        calls = [track(lane, "big", 2 * MIB) for _ in range(LARGE_OF_OWNER + 3)]
        calls.append(track(lane, "small", 2 * MIB))
        await asyncio.sleep(0.1)
        assert lane._large._of_owner == {"one": LARGE_OF_OWNER, "another": 1}
        worker.reads.set()
        assert [await value(call) for call in calls] == [2 * MIB] * len(calls)
        assert not lane._large._of_owner
        assert lane.overdue_s() == 0.0


async def test_a_large_reply_of_another_owner_passes_larger_ones() -> None:
    async with lane_and_worker() as (lane, worker):
        worker.state = bytes(32 * MIB)
        larger = [lane.call("big", encode_call("checkpoint", "big", {})) for _ in range(LARGE_OF_OWNER + 1)]
        while len(lane._arriving) < LARGE_OF_OWNER:
            await asyncio.sleep(0)
        worker.state = bytes(MIB)
        assert await value(lane.call("small", encode_call("checkpoint", "small", {}))) == worker.state
        assert not any(call.done() for call in larger)
        assert len(await value(larger[0])) == 32 * MIB
        assert len(await value(larger[2])) == MIB


async def test_a_large_call_of_a_released_key_is_taken_back() -> None:
    async with lane_and_worker() as (lane, worker):
        worker.reads.clear()
        await value(track(lane, "small", 1))
        gone = [track(lane, "big", 8 * MIB) for _ in range(LARGE_OF_OWNER + 1)]
        stays = track(lane, "also big", 2 * MIB)
        await asyncio.sleep(0.1)
        lane.forget("big")
        worker.reads.set()
        for call in gone:
            with pytest.raises(LaneLost, match=LaneLoss.RELEASED):
                await call
        assert await value(stays) == 2 * MIB
        assert worker.heard == ["track small", "drop big", "track also big"]
        assert not worker.wire._parts
        assert not lane._large._of_owner


async def test_a_lane_that_takes_no_part_is_overdue_and_its_calls_are_lost_with_it() -> None:
    async with lane_and_worker() as (lane, worker):
        worker.reads.clear()
        await value(track(lane, "small", 1))
        call = track(lane, "big", 8 * MIB)
        await asyncio.sleep(0.2)
        assert 0.1 < lane.overdue_s() < PATIENCE_S
        lane.connection_lost(None)
        with pytest.raises(LaneLost, match=LaneLoss.DIED):
            await call
        worker.reads.set()
