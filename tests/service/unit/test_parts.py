"""The small parts: fair turns, waiting frames, buckets, memories, the past."""

from __future__ import annotations

import asyncio
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.lanes.cores import lanes_for, usable_cores
from service.lanes.fair_queue import FairOwnerQueue, FairQueue
from service.lanes.framing import FramingError, Splitter, decode_call, encode_call, framed
from service.protocol.enums import Mode
from service.protocol.problems import ProblemError
from service.protocol.requests import Remove
from service.sessions.byte_budget import ByteBudget, Reservation
from service.sessions.interface import QueuedFrame
from service.sessions.rate_limiter import TokenBucket
from service.sessions.trajectory import TrajectoryEntry, TrajectoryLog, unpacked
from service.sessions.ttl_cache import TTLCache
from service.stream.frame_queue import FrameQueue

ROW = [0, [1.0, 2.0, 3.0, 4.0], "tracking", True, None, None, 12.5, True, 1.0, 0.9]


def test_key_that_used_least_time_is_next() -> None:
    queue: FairQueue[int] = FairQueue()
    turns = []
    for n in range(100):
        queue.push("flood", n)
    for n in range(10):
        queue.push("calm", n)
    for _ in range(40):
        turn = queue.pop()
        assert turn is not None
        turns.append(turn[0])
        queue.charge(turn[0], 0.004 if turn[0] == "flood" else 0.002)
    # The calm one is never behind more than one turn of the other, until it has nothing more.
    assert turns[:15].count("calm") == 10
    assert "flood" in turns[:3]


def test_pausing_key_saves_no_credit() -> None:
    queue: FairQueue[int] = FairQueue()
    queue.push("old", 0)
    for n in range(50):
        queue.push("busy", n)
        turn = queue.pop()
        assert turn is not None
        queue.charge(turn[0], 1.0)
    queue.push("old", 1)
    for n in range(4):
        queue.push("busy", n)
    first = [turn[0] for turn in (queue.pop(), queue.pop()) if turn]
    queue.charge("old", 1.0)
    assert first.count("old") == 1


def test_forgetting_key_returns_its_waiting_items() -> None:
    queue: FairQueue[str] = FairQueue()
    queue.push("a", "1")
    queue.push("a", "2")
    assert queue.forget("a") == ["1", "2"]
    assert queue.pop() is None
    queue.charge("a", 1.0)
    assert len(queue) == 0


def test_owners_share_a_lane_whatever_the_number_of_their_sessions() -> None:
    turns: FairOwnerQueue[tuple[str, str]] = FairOwnerQueue()
    keys = [("many", f"m{n}") for n in range(5)] + [("one", "o")]
    for owner, key in keys * 40:
        turns.push(owner, key, (owner, key))
    served: Counter[tuple[str, str]] = Counter()
    for _ in range(60):
        turn = turns.pop()
        assert turn is not None
        served[turn] += 1
        turns.charge(*turn, 0.004)
    assert served["one", "o"] == 30
    assert {served[key] for key in keys[:5]} == {6}


def test_an_owner_is_forgotten_with_its_last_session() -> None:
    turns: FairOwnerQueue[str] = FairOwnerQueue()
    turns.push("a", "first", "1")
    turns.push("a", "second", "2")
    turns.push("b", "third", "3")
    assert turns.forget("a", "first") == ["1"]
    turns.charge("a", "first", 1.0)  # it was in work
    assert turns.pop() == "3"
    assert turns.forget("a", "second") == ["2"]
    assert turns.forget("a", "second") == []
    assert turns.pop() is None
    turns.charge("a", "second", 1.0)
    turns.push("a", "second", "4")
    assert turns.pop() == "4"


def frame(seq: int) -> QueuedFrame:
    return QueuedFrame(b"", seq, None, None, 0.0, 0.0)


def queue_of(mode: Mode, credit: int = 2) -> FrameQueue:
    return FrameQueue(mode, credit, lambda: None, Reservation(ByteBudget(1 << 20)))


CONTROL = Remove(target=0)


async def test_latest_keeps_the_newest_and_the_order_of_controls() -> None:
    waiting = queue_of(Mode.LATEST)
    waiting.put_frame(frame(1), [])
    waiting.put_control(CONTROL)
    waiting.put_frame(frame(2), [CONTROL])
    waiting.put_frame(frame(3), [])
    waiting.put_frame(frame(4), [])
    jobs = [await waiting.next() for _ in range(3)]
    assert [job.frame and job.frame.seq for job in jobs] == [None, 2, 4]
    assert waiting.take_dropped() == 2
    assert waiting.take_dropped() == 0


async def test_lossless_refuses_above_the_credit() -> None:
    waiting = queue_of(Mode.LOSSLESS)
    waiting.put_frame(frame(1), [])
    waiting.put_frame(frame(2), [])
    with pytest.raises(ProblemError, match="over-credit"):
        waiting.put_frame(frame(3), [])
    job = await waiting.next()
    waiting.answered(job)
    waiting.put_frame(frame(4), [])
    assert [(await waiting.next()).frame.seq for _ in range(2)] == [2, 4]  # type: ignore[union-attr]


async def test_controls_that_wait_are_bounded() -> None:
    waiting = queue_of(Mode.LATEST)
    for _ in range(64):
        waiting.put_control(Remove(target=0, on="next"))
    with pytest.raises(ProblemError, match="rate-limited"):
        waiting.put_control(CONTROL)
    taken = waiting.take_for_next()
    assert len(taken) == 64
    waiting.refused(taken)
    waiting.put_control(CONTROL)


async def test_waiting_reader_is_woken() -> None:
    waiting = queue_of(Mode.LATEST)
    task = asyncio.create_task(waiting.next())
    await asyncio.sleep(0)
    waiting.put_frame(frame(1), [])
    assert (await asyncio.wait_for(task, 1)).frame is not None
    waiting.put_frame(frame(2), [])
    waiting.discard()
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(waiting.next(), 0.01)


def test_a_bucket_lets_a_burst_through_and_then_the_rate() -> None:
    bucket = TokenBucket(10, now=0.0)
    assert [bucket.take(0.0) for _ in range(10)] == [0.0] * 10
    assert bucket.take(0.0) == pytest.approx(0.1)
    assert bucket.take(0.1) == 0.0
    assert bucket.take(0.1) > 0
    assert [bucket.take(100.0) for _ in range(11)].count(0.0) == 10


def test_cached_values_expire_and_are_bounded() -> None:
    now = 0.0
    cache: TTLCache[str] = TTLCache(2, 10, lambda: now)
    cache.put("me", "a", "A")
    cache.put("me", "b", "B", ttl_s=1)
    now = 5.0
    assert (cache.get("a"), cache.get("b")) == ("A", None)
    cache.put("me", "c", "C")
    cache.put("me", "d", "D")
    assert (cache.get("a"), len(cache)) == (None, 2)
    assert cache.pop("c") == "C"
    assert cache.pop("c") is None
    now = 20.0
    cache.sweep()
    assert len(cache) == 0


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 9), st.sampled_from((None, 1.0, 7.0))), max_size=60))
def test_owner_cannot_evict_values_of_another(puts: list[tuple[str, int, float | None]]) -> None:
    now, most = 0.0, 3
    cache: TTLCache[int] = TTLCache(most, 5.0, lambda: now)
    alone: dict[str, TTLCache[int]] = {owner: TTLCache(most, 5.0, lambda: now) for owner in "abc"}
    for owner, number, seconds in puts:
        now += 1
        for one in (cache, alone[owner]):
            one.put(owner, f"{owner}{number}", number, seconds)
        for other, own in alone.items():
            keys = [f"{other}{n}" for n in range(10)]
            assert [cache.get(key) for key in keys] == [own.get(key) for key in keys]
            assert sum(cache.get(key) is not None for key in keys) <= most
    now += 100
    cache.sweep()
    assert len(cache) == len(cache._keys) == 0


def test_trajectory_is_bounded_by_bytes() -> None:
    past = TrajectoryLog(4096)
    for seq in range(1000):
        past.append(TrajectoryEntry(seq, "ts", [640, 480], None, [ROW]))
    assert 5 < len(past) < 40
    entries = list(unpacked(past.after(-1)))
    assert entries[-1] == TrajectoryEntry(999, "ts", [640, 480], None, [ROW])
    assert [e.seq for e in unpacked(past.after(997))] == [998, 999]
    past.amend([ROW, [1, *ROW[1:]]], [0, 0, 9, 9])
    last = next(unpacked(past.after(998)))
    assert (last.seq, last.ts, last.region, len(last.rows)) == (999, "ts", [0, 0, 9, 9], 2)


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.binary(max_size=300)), max_size=8), st.data())
def test_messages_survive_any_fragmentation(messages: list[tuple[int, bytes]], data: st.DataObject) -> None:
    stream = b"".join(b"".join(framed(call, [payload])) for call, payload in messages)
    splitter, heard = Splitter(), []
    while stream:
        n = data.draw(st.integers(1, len(stream)))
        heard += list(splitter.feed(stream[:n]))
        stream = stream[n:]
    assert heard == messages


def test_a_monstrous_length_is_refused() -> None:
    with pytest.raises(FramingError):
        list(Splitter().feed(b"\xff" * 8))


@given(st.binary(max_size=2000))
def test_a_call_carries_its_bytes(data: bytes) -> None:
    payload = b"".join(encode_call("track", "key", {"seq": 7}, data))
    assert decode_call(memoryview(payload)) == ("track", "key", {"seq": 7}, data)


def test_cores_by_quota(tmp_path: object) -> None:
    from pathlib import Path

    root = Path(str(tmp_path))
    (root / "cpu.max").write_text("150000 100000\n")
    assert usable_cores(root) == 1
    (root / "cpu.max").write_text("max 100000\n")
    everything = usable_cores(root)
    assert everything >= 1
    (root / "cpu.max").unlink()
    assert usable_cores(root) == everything
    (root / "cpu").mkdir()
    (root / "cpu" / "cpu.cfs_quota_us").write_text("-1\n")
    (root / "cpu" / "cpu.cfs_period_us").write_text("100000\n")
    assert usable_cores(root) == everything
    (root / "cpu" / "cpu.cfs_quota_us").write_text("100000\n")
    assert usable_cores(root) == 1


def test_from_three_cores_on_one_is_left_to_the_front() -> None:
    assert [lanes_for(cores) for cores in (1, 2, 3, 4, 8)] == [1, 2, 2, 3, 7]
