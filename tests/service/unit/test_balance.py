"""How the work is spread over lanes, and what is sent to one while it works; with lanes that are no processes."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from mfcmt_core.images import FrameLimits
from service.lanes.balance import FULL, IDLE, KEY_RESTS_S, LANES_REST_S, Rebalancer, RecentUsage
from service.lanes.framing import TOOK, Splitter, encode_call, encode_reply, framed
from service.lanes.interface import LaneCrowded
from service.lanes.limits import LaneLimits
from service.lanes.pool import LanePool
from service.lanes.process import PIPELINE, SHORT_S, LaneProcess


def pool_of(lanes: int, places: int = 4) -> LanePool:
    """Lanes that are ready, without processes."""
    pool = LanePool(
        lanes, places, LaneLimits(FrameLimits(), 1, 1), deadline_s=1, start_timeout_s=1, max_rss_bytes=1 << 40
    )
    for lane in pool._lanes:
        lane.ready = True
    return pool


def test_recent_usage_is_share_of_the_last_seconds() -> None:
    usage = RecentUsage(0.0)
    for second in range(1, 31):
        usage.add("busy", 0.9)
        usage.add("calm", 0.1)
        usage.update(float(second))
    assert usage.part("busy") == pytest.approx(0.9, abs=0.01)
    assert usage.part("calm") == pytest.approx(0.1, abs=0.01)
    usage.add("late", 4.0)  # one operation, told at its end
    for second in range(31, 35):
        usage.update(float(second))
        assert usage.part("late") <= 1.0
    assert usage.part("late") > 0.7
    assert usage.part("busy") < 0.3
    usage.forget("late")
    for second in range(35, 80):
        usage.update(float(second))
    assert not dict(usage.parts())


def test_a_key_moves_from_a_full_lane_to_an_idle_one() -> None:
    assert Rebalancer().choose([{"a": 0.5, "b": 0.45}, {"c": 0.1}], [0, 1], 0.0) in (("a", 1), ("b", 1))
    # The one that evens the two out, and never into what would be as full.
    assert Rebalancer().choose([{"a": 0.6, "b": 0.3, "c": 0.05}, {}], [0, 1], 0.0) == ("a", 1)
    assert Rebalancer().choose([{"hog": 0.95, "calm": 0.04}, {"x": 0.3}], [0, 1], 0.0) == ("calm", 1)
    # The idlest of those with room.
    assert Rebalancer().choose([{"x": 0.3}, {"a": 0.5, "b": 0.5}, {"y": 0.1}], [0, 1, 2], 0.0) in (("a", 2), ("b", 2))
    assert Rebalancer().choose([{"x": 0.3}, {"a": 0.5, "b": 0.5}, {"y": 0.1}], [0, 1], 0.0) in (("a", 0), ("b", 0))


@pytest.mark.parametrize(
    ("parts", "room"),
    [
        ([{"alone": 1.0}, {}], [0, 1]),
        ([{"hog": 0.99, "nothing": 0.01}, {}], [0, 1]),
        ([{"a": FULL / 2 - 0.01, "b": FULL / 2}, {}], [0, 1]),
        ([{"a": 0.5, "b": 0.5}, {"c": IDLE + 0.01}], [0, 1]),
        ([{"a": 0.5, "b": 0.5}, {}], [0]),
        ([{"a": 0.5, "b": 0.5}], [0]),
    ],
)
def test_no_session_moves_without_gain(parts: list[dict[str, float]], room: list[int]) -> None:
    assert Rebalancer().choose(parts, room, 0.0) is None


def test_no_session_moves_back_and_forth() -> None:
    """Whatever a session does, it stays for a while where it came to, and lanes settle between two moves."""
    rebalancer = Rebalancer()
    assert rebalancer.choose([{"a": 0.7, "b": 0.3}, {}], [0, 1], 0.0) == ("b", 1)
    busy = [{"c": 0.3}, {"b": 0.5, "d": 0.5}]
    assert rebalancer.choose(busy, [0, 1], LANES_REST_S / 2) is None
    assert rebalancer.choose([*busy, {"e": 0.4, "f": 0.6}, {}], [0, 1, 2, 3], LANES_REST_S / 2) == ("e", 3)
    assert rebalancer.choose(busy, [0, 1], LANES_REST_S) == ("d", 0)
    assert rebalancer.choose([{}, {"b": 0.6, "d": 0.4}], [0, 1], KEY_RESTS_S - 1) is None
    assert rebalancer.choose([{}, {"b": 0.6, "d": 0.4}], [0, 1], KEY_RESTS_S) == ("b", 0)


async def test_new_session_gets_place_in_idlest_lane() -> None:
    """Sessions that pause count for half of their place, so many of them do not go where one is busy."""
    pool = pool_of(2, places=8)
    for key in "abcd":
        pool.reserve(key, "me")
    assert [sorted(lane.keys) for lane in pool._lanes] == [["a", "c"], ["b", "d"]]
    start = pool._usage._since
    pool._usage.add("a", 8.0)
    pool._usage.add("gone", 8.0)
    pool._usage.update(start + 8.0)
    for key in "efgh":
        pool.reserve(key, "me")
    assert [sorted(lane.keys) for lane in pool._lanes] == [["a", "c"], ["b", "d", "e", "f", "g", "h"]]
    pool.release("a")
    pool.reserve("i", "me")
    assert pool._homes["i"] is pool._lanes[0]


async def test_a_move_takes_a_place_or_changes_nothing() -> None:
    pool = pool_of(3, places=2)
    pool._lanes[2].ready = False
    for key in "abc":
        pool.reserve(key, "me")
    assert not pool.move("a", 0)
    assert not pool.move("a", 2)
    assert not pool.move("never", 1)
    assert pool.move("a", 1)
    assert [sorted(lane.keys) for lane in pool._lanes] == [["c"], ["a", "b"], []]
    assert (await pool.regain("a", "me")).lane == 1
    assert not pool.move("c", 1)  # full
    assert pool.holds("c")


async def test_pool_announces_key_that_should_move(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.lanes.pool.BALANCE_EVERY_S", 0.001)
    pool = pool_of(2)
    for key in "abc":
        pool.reserve(key, "me")
    for key in "ac":
        pool._usage._parts[key] = 0.5
    pool._usage._since += 3600  # so that what was used usage stays as it is
    watching = asyncio.create_task(pool._balance())
    event = await anext(pool.events())
    assert isinstance(event, LaneCrowded)
    assert (event.key in "ac", event.lane) == (True, 1)
    watching.cancel()


class Socket:
    """What a lane was sent."""

    def __init__(self) -> None:
        self.calls: list[int] = []
        self._splitter = Splitter()

    def writelines(self, buffers: list[bytes]) -> None:
        for data in buffers:
            self.calls += [call for call, _ in self._splitter.feed(bytes(data))]


class Lane:
    """A lane whose answers the test gives; ``clock`` is the time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = 0.0
        monkeypatch.setattr("service.lanes.process.time.monotonic", lambda: self.clock)
        self.used: list[tuple[str, float]] = []
        self.process = LaneProcess(
            0, on_ready=self.ignore, on_lost=self.ignore, on_used=lambda *use: self.used.append(use)
        )
        self.socket = Socket()
        self.process._transport = self.socket  # type: ignore[assignment]
        self.answered = 0

    def ignore(self, *_: Any) -> None: ...

    def call(self, key: str, size: int = 10) -> None:
        self.process.keys[key] = "me"
        self.process.call(key, encode_call("track", key, {}, b"f" * size))

    def answer(self, seconds: float) -> None:
        """Answer the call in work after so long."""
        self.clock += seconds
        self.answered += 1
        reply = [TOOK.pack(seconds), encode_reply(None, None)]
        self.process.data_received(b"".join(framed(self.answered, reply)))

    @property
    def in_pipe(self) -> int:
        return len(self.socket.calls) - self.answered


async def test_nothing_is_sent_behind_a_long_call(monkeypatch: pytest.MonkeyPatch) -> None:
    lane = Lane(monkeypatch)
    lane.call("new")
    lane.call("other")
    assert lane.in_pipe == 1  # how long it takes is not known
    lane.answer(SHORT_S / 2)
    lane.answer(SHORT_S / 2)
    for key in ("new", "other", "new"):
        lane.call(key)
    assert lane.in_pipe == PIPELINE
    lane.answer(SHORT_S * 20)  # what the first of them took
    assert lane.in_pipe == PIPELINE
    lane.answer(SHORT_S / 2)
    lane.call("other")
    assert lane.in_pipe == 1
    lane.answer(SHORT_S / 2)
    lane.answer(SHORT_S / 2)
    for _ in range(12):  # it is forgotten after a while
        lane.call("new")
        lane.answer(SHORT_S / 2)
    lane.call("new")
    lane.call("other")
    assert lane.in_pipe == PIPELINE
    lane.answer(0.0)
    lane.answer(0.0)
    assert {key for key, _ in lane.used} == {"new", "other"}


async def test_a_reply_without_its_time_is_out_of_order(monkeypatch: pytest.MonkeyPatch) -> None:
    lane = Lane(monkeypatch)
    lane.call("key")
    killed: list[str] = []
    monkeypatch.setattr(lane.process, "kill", lambda: killed.append("lane"))
    lane.process.data_received(b"".join(framed(1, [b"x"])))
    assert killed
