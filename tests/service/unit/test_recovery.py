"""Journals and their bounds, the database and its disk, with lanes that only answer."""

from __future__ import annotations

import asyncio
import itertools
import sqlite3
from collections import deque
from pathlib import Path
from typing import Any

import pytest
from prometheus_client import generate_latest

from mfcmt_core.images import FrameLimits
from service.lanes.framing import Splitter, decode_call, decode_reply, encode_reply, framed
from service.lanes.interface import AtCapacity, Buffers, LaneCrowded, LaneLost, Place
from service.lanes.limits import LaneLimits
from service.lanes.pool import LanePool
from service.lanes.process import LaneProcess
from service.observability.metrics import Metrics
from service.protocol.problems import ProblemError
from service.sessions.database import SavedSession
from service.sessions.interface import QueuedFrame
from service.sessions.registry import SessionRegistry
from service.sessions.replay_log import Operation, RecoveryBudget, ReplayLog
from service.sessions.session import Session
from service.sessions.sqlite_store import SqliteStore
from service.sessions.state_file import FILE, StateDirError
from service.settings import Settings

from .test_registry import Lanes, World, settle

KIB = 1024


class Recording(Lanes):
    """Lanes that note operations, and die when told to."""

    def __init__(self, places: int) -> None:
        super().__init__(places)
        self.ops: list[tuple[str, Any]] = []
        self.deaths: list[tuple[str, bool]] = []

    async def call(self, key: str, request: Buffers) -> bytes:
        op, _, args, _ = decode_call(memoryview(b"".join(request)))
        self.ops.append((op, args.get("seq")))
        if self.deaths and key in self.keys:
            cause, in_work = self.deaths.pop(0)
            self.keys.discard(key)
            raise LaneLost(cause, in_work=in_work)
        if op == "checkpoint":
            return encode_reply(None, b"c" * 10 * KIB)
        return await super().call(key, request)


def text(metrics: Metrics) -> bytes:
    return generate_latest(metrics.registry)


class Keeping(World):
    """A registry over lanes that note operations."""

    lanes: Recording

    def __init__(self, places: int = 2, **settings: Any) -> None:
        super().__init__(places, **settings)
        self.lanes = Recording(places)
        self.metrics = Metrics()
        self.registry = SessionRegistry(self.settings, self.lanes, self.metrics, lambda: self.now)

    async def track(self, session: Session, size: int = KIB) -> int:
        result, _, _ = await session.track(QueuedFrame(b"f" * size, session.number(None), None, None, 0.0, 0.0))
        await settle()  # for a checkpoint, behind the frame
        seq: int = result["seq"]
        return seq


async def test_checkpoint_is_taken_at_the_interval_only() -> None:
    world = Keeping(checkpoint_every_frames=13)
    session = await world.create()
    for _ in range(40):
        await world.track(session)
    at = [index for index, (op, _) in enumerate(world.lanes.ops) if op == "checkpoint"]
    gaps = {later - earlier - 1 for earlier, later in itertools.pairwise(at)}
    assert 1 <= at[0] - 1 <= 10
    assert gaps == {10}
    assert len(session.lane.replay_log.operations) < 10
    before = len(world.lanes.ops)
    await session.prepare_to_stop()
    await session.prepare_to_stop()
    assert [op for op, _ in world.lanes.ops[before:]] in (["checkpoint"], [])


async def test_lost_operations_are_replayed_in_order() -> None:
    world = Keeping(checkpoint_every_frames=100)
    session = await world.create()
    session.lane._frames_until_checkpoint = 100
    for _ in range(3):
        await world.track(session)
    await session.control({"type": "add", "box": [1, 2, 3, 4]})
    world.lanes.refuse = "bad-region"
    with pytest.raises(ProblemError, match="bad-region"):
        await world.track(session)
    world.lanes.refuse = None
    world.lanes.keys.clear()
    world.lanes.ops.clear()
    assert await world.track(session) == 5
    assert world.lanes.ops == [
        ("track", 5),
        ("create", None),
        ("track", 1),
        ("track", 2),
        ("track", 3),
        ("control", None),
        ("track", 5),
    ]


async def test_replay_limit_of_session_forces_checkpoint() -> None:
    world = Keeping(max_replay_bytes=64 * KIB, checkpoint_every_frames=10_000)
    session = await world.create()
    session.lane._frames_until_checkpoint = 10_000
    for _ in range(50):
        await world.track(session, 10 * KIB)
        assert session.lane.replay_log.bytes <= 64 * KIB
    await world.track(session, 200 * KIB)  # larger than the bound: alone
    await world.track(session, 10 * KIB)
    assert session.lane.replay_log.bytes <= 64 * KIB
    assert b'reason="bytes"' in text(world.metrics)


async def test_global_recovery_limit_refuses_new_sessions() -> None:
    world = Keeping(places=9, max_recovery_bytes=1024 * KIB, checkpoint_every_frames=10_000)
    sessions = [await world.create() for _ in range(3)]
    for session in sessions:
        session.lane._frames_until_checkpoint = 10_000
    budget = world.registry.store.budget
    for _ in range(60):
        for session in sessions:
            await world.track(session, 30 * KIB)
        assert budget.checkpoints + budget.frames <= (1024 + 3 * 32) * KIB
    assert b'reason="budget"' in text(world.metrics)
    budget.limit = 1
    with pytest.raises(ProblemError, match="at-capacity"):
        await world.create()
    for session in sessions:
        world.registry.close("me", session.id)
    assert (budget.checkpoints, budget.frames) == (0, 0)


def test_one_of_several_owners_cannot_fill_the_recovery_memory() -> None:
    budget = RecoveryBudget(100 * KIB, lambda: 2)
    ReplayLog(budget, "greedy").append(Operation("create", {}, bytes(60 * KIB)))
    assert budget.spent("greedy")
    assert not budget.spent("other")


def test_a_single_owner_can_use_all_of_the_recovery_memory() -> None:
    budget = RecoveryBudget(100 * KIB)
    ReplayLog(budget, "me").append(Operation("create", {}, bytes(60 * KIB)))
    assert not budget.spent("me")


async def test_frame_that_kills_two_workers_ends_session() -> None:
    world = Keeping()
    session, other = await world.create(), await world.create()
    world.lanes.deaths = [("died", True), ("died", False), ("hung", False)]
    assert await world.track(session) == 1
    world.lanes.deaths = [("died", True)]
    assert await world.track(session) == 2
    # The frame, then a replayed one, then the frame again: each only once in a row.
    world.lanes.deaths = [("died", True)]
    assert await world.track(other) == 1

    async def die_of_tracking(key: str, request: Buffers) -> bytes:
        if key == session.id and decode_call(memoryview(b"".join(request)))[2].get("seq") == 3:
            world.lanes.deaths = [("died", True)]
        return await Recording.call(world.lanes, key, request)

    world.lanes.call = die_of_tracking  # type: ignore[method-assign]
    with pytest.raises(ProblemError, match="frame 3 ended its worker twice"):
        await world.track(session)
    with pytest.raises(ProblemError, match="frame 3 ended its worker twice"):
        world.registry.find("me", session.id)
    assert world.registry.find("me", other.id) is other


class Two(Recording):
    """Two lanes, each with places; which one has a key."""

    def __init__(self, places: int) -> None:
        super().__init__(places)
        self.lane: dict[str, int] = {}

    def move(self, key: str, lane: int) -> bool:
        if self.lane.get(key, 0) == lane or lane > 1:
            return False
        self.lane[key] = lane
        return True

    async def regain(self, key: str, owner: str) -> Place:
        if key in self.keys:
            return Place(self.lane.get(key, 0), "")
        return await super().regain(key, owner)


async def test_a_session_moves_from_a_checkpoint_between_two_frames() -> None:
    """What waits comes after it; a lane that dies meanwhile is made up for as ever."""
    world = Keeping(checkpoint_every_frames=100)
    world.lanes = world.registry._lanes = world.registry.store._lanes = Two(2)
    session = await world.create()
    session.lane._frames_until_checkpoint = 100
    follower = asyncio.create_task(world.registry.follow_lanes())
    await world.track(session)
    world.lanes.ops.clear()
    world.lanes.lost.put_nowait(LaneCrowded(session.id, 1))
    world.lanes.lost.put_nowait(LaneCrowded("ended meanwhile", 1))
    await asyncio.sleep(0)
    assert await asyncio.gather(*(world.track(session) for _ in range(3))) == [2, 3, 4]
    assert [op for op, _ in world.lanes.ops] in (
        ["checkpoint", "revive", "track", "track", "track"],
        ["track", "checkpoint", "revive", "track", "track"],
    )
    assert b"mfcmt_session_moves_total 1.0" in text(world.metrics)
    world.lanes.ops.clear()
    world.lanes.lost.put_nowait(LaneCrowded(session.id, 2))  # no room
    await settle()
    assert [op for op, _ in world.lanes.ops] == ["checkpoint"]
    world.lanes.ops.clear()
    world.lanes.deaths = [("died", True)]
    world.lanes.lost.put_nowait(LaneCrowded(session.id, 0))
    await settle()
    assert await world.track(session) == 5
    assert [op for op, _ in world.lanes.ops] == ["checkpoint", "revive", "checkpoint", "revive", "track"]
    assert b"mfcmt_session_moves_total 2.0" in text(world.metrics)
    follower.cancel()


async def test_cancelled_operation_is_rolled_back() -> None:
    world = Keeping(checkpoint_every_frames=100)
    session = await world.create()
    session.lane._frames_until_checkpoint = 100
    await world.track(session)
    tracking = asyncio.create_task(world.track(session))
    await asyncio.sleep(0)
    tracking.cancel()
    await asyncio.gather(tracking, return_exceptions=True)
    world.lanes.ops.clear()
    await world.track(session)
    assert world.lanes.ops == [("create", None), ("track", 1), ("track", 3)]


async def test_session_without_lane_refuses_calls_and_stays() -> None:
    world = Keeping(recovery_timeout_s=0.02)
    session = await world.create()
    world.lanes.keys.clear()
    regain = world.lanes.regain

    async def never(key: str, owner: str) -> Place:
        await asyncio.sleep(60)
        raise AtCapacity

    world.lanes.regain = never  # type: ignore[method-assign]
    with pytest.raises(ProblemError) as refused:
        await world.track(session)
    assert refused.value.code == "at-capacity"
    assert refused.value.members["retry_after_s"] > 0
    world.lanes.regain = regain  # type: ignore[method-assign]
    assert await world.track(session) == 2


def test_closed_replay_log_keeps_nothing() -> None:
    budget = RecoveryBudget(10)
    journal = ReplayLog(budget, "me")
    journal.append(Operation("create", {}, b"first"))
    journal.append(Operation("track", {"seq": 1}, b"second"))
    assert budget.spent("me")
    journal.close()
    journal.append(Operation("track", {"seq": 2}, b"third"))
    assert (budget.checkpoints, budget.frames, journal.checkpoint, journal.operations) == (0, 0, None, [])


async def test_places_of_lost_sessions_are_kept_for_them() -> None:
    """In the lane that comes for the lost one; elsewhere only while that one keeps dying."""
    pool = LanePool(2, 3, LaneLimits(FrameLimits(), 1, 1), deadline_s=1, start_timeout_s=1, max_rss_bytes=1 << 40)
    for lane in pool._lanes:
        lane.ready = True
    for key in "abcd":
        pool.reserve(key, "me")
    lost = pool._homes["a"]
    assert sorted(lost.keys) == ["a", "c"]
    began: list[LaneProcess] = []
    pool._begin = lambda lane, wait_s=0.0: _noted(began, lane)  # type: ignore[method-assign,assignment]
    lost.lost, lost.ready = True, False
    pool._lost(lost, "died")
    waiting = [asyncio.create_task(pool.regain(key, "me")) for key in "ac"]
    pool.reserve("e", "me")
    with pytest.raises(AtCapacity):
        pool.reserve("f", "me")
    await asyncio.sleep(0)
    fresh = pool._lanes[lost.number]
    assert began == [fresh]
    assert not pool.holds("a")
    fresh.ready = True
    pool._ready(fresh)
    assert await asyncio.gather(*waiting) == [Place(fresh.number, "died")] * 2
    assert sorted(fresh.keys) == ["a", "c"]
    pool.reserve("f", "me")
    pool.release("e")
    for _ in range(4):  # keeps dying
        pool._lanes[fresh.number].ready = False
        pool._lost(pool._lanes[fresh.number], "died")
    assert pool.status()[fresh.number].failing
    assert (await pool.regain("a", "me")).cause == "died"
    assert pool._homes["a"] is not pool._lanes[fresh.number]
    gone = asyncio.create_task(pool.regain("c", "me"))
    await asyncio.sleep(0)
    pool.release("c")
    with pytest.raises(LaneLost, match="released"):
        await gone


async def _noted(began: list[LaneProcess], lane: LaneProcess) -> None:
    began.append(lane)


def test_a_long_value_is_not_copied() -> None:
    for size in (10, 70_000, 200_000):
        payload = encode_reply(None, b"x" * size)
        message = b"".join(framed(7, [payload]))
        splitter = Splitter()
        heard = [reply for start in range(0, len(message), 65_536) for reply in splitter.feed(message[start:][:65_536])]
        assert [(call, bytes(payload)) for call, payload in heard] == [(7, payload)]
        code, value = decode_reply(heard[0][1])
        assert (code, bytes(value)) == (None, b"x" * size)
        assert isinstance(value, memoryview) == (size > 65_535)
        again = list(splitter.feed(message[:20]))
        assert again == []


def saved(sid: str, seq: int, entries: list[int], first: int = 0, whole: bool = False) -> SavedSession:
    base = Operation("revive", {}, b"state of %d" % seq)
    return SavedSession(sid, "me", {"seq": seq}, base, deque((n, b"entry") for n in entries), first, whole)


def reopened(folder: Path) -> tuple[SqliteStore, list[SavedSession]]:
    database = SqliteStore(folder, Metrics())
    database.take_over()
    return database, database.load()[0]


def test_newest_state_is_on_disk_with_whole_trajectory(tmp_path: Path) -> None:
    database, found = reopened(tmp_path)
    assert found == []
    database.save(saved("a", 2, [0, 1, 2]))
    database.save(saved("b", 1, [0, 1]))
    database.save(saved("a", 5, [2, 3, 4, 5], first=1, whole=True))
    database.delete("b")
    assert database.flush(10)
    database.close()
    database, (one,) = reopened(tmp_path)
    assert (one.id, one.owner, one.checkpoint.data, one.whole) == ("a", "me", b"state of 5", True)
    assert [seq for seq, _ in one.entries] == [1, 2, 3, 4, 5]
    database.close()
    database, (one,) = reopened(tmp_path)
    assert not one.whole  # a process had it, and did not say that nothing happened
    database.close()


def test_unusable_state_directory_is_reported(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"not a database" * 1000)
    with pytest.raises(StateDirError, match="move it away"):
        SqliteStore(tmp_path, Metrics()).open()
    assert (tmp_path / FILE).read_bytes().startswith(b"not a database")
    (tmp_path / FILE).unlink()
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("PRAGMA user_version = 7")
    with pytest.raises(StateDirError, match="version 7"):
        SqliteStore(tmp_path, Metrics()).open()
    with pytest.raises(StateDirError, match="able to write"):
        SqliteStore(tmp_path / FILE, Metrics()).open()


def test_settings_of_recovery() -> None:
    assert Settings().checkpoint_every_frames == 30
    for wrong in ({"checkpoint_every_frames": 0}, {"max_replay_bytes": 1}, {"max_recovery_bytes": 1}):
        with pytest.raises(ValueError):
            Settings(**wrong)
