"""The registry with a clock of its own and lanes that only answer: who may stay, who must go, what is remembered."""

from __future__ import annotations

import asyncio
import gc
import weakref
from collections.abc import AsyncIterator, Sequence
from dataclasses import asdict
from typing import Any

import pytest

from service.lanes.framing import decode_call, encode_reply
from service.lanes.interface import AtCapacity, Buffers, KeysLost, LaneEvent, LaneLost, LaneStatus, LaneUsage, Place
from service.observability.metrics import Metrics
from service.protocol.enums import Preset
from service.protocol.problems import ProblemError
from service.protocol.requests import Options
from service.sessions.admission import KeyQuotas
from service.sessions.interface import QueuedFrame
from service.sessions.registry import SessionRegistry
from service.sessions.session import Session
from service.settings import Settings

ROW = [0, [1.0, 2.0, 3.0, 4.0], "tracking", None, None, None, None, True, 1.0, 0.9]
STATE = {"seq": 0, "size": [64, 48], "region": None, "rows": [ROW], "target": 0, "decode_s": 0.001, "track_s": 0.001}


class Lanes:
    """Places, and an answer to everything."""

    def __init__(self, places: int) -> None:
        self.places, self.ready = places, True
        self.keys: set[str] = set()
        self.lost: asyncio.Queue[LaneEvent] = asyncio.Queue()
        self.refuse: str | None = None

    async def start(self) -> None: ...

    async def stop(self) -> None: ...

    def reserve(self, key: str, owner: str) -> None:
        if len(self.keys) >= self.places:
            raise AtCapacity
        self.keys.add(key)

    def move(self, key: str, lane: int) -> bool:
        return False

    async def regain(self, key: str, owner: str) -> Place:
        await asyncio.sleep(0)
        self.reserve(key, owner)
        return Place(0, "died")

    def holds(self, key: str) -> bool:
        return key in self.keys

    async def call(self, key: str, request: Buffers) -> bytes:
        await asyncio.sleep(0)
        if key not in self.keys:
            raise LaneLost("absent")
        op, _, args, _ = decode_call(memoryview(b"".join(request)))
        if self.refuse:
            return encode_reply(self.refuse, ["no", {}])
        return encode_reply(None, STATE | {"seq": args.get("seq", 0), "answers": []} if op != "snapshot" else b"s")

    def release(self, key: str) -> None:
        self.keys.discard(key)

    async def events(self) -> AsyncIterator[LaneEvent]:
        while True:
            yield await self.lost.get()

    def status(self) -> list[LaneStatus]:
        return [LaneStatus(0, self.ready, False, len(self.keys), {})]

    def usage(self) -> list[LaneUsage]:
        return []


async def test_creation_before_a_lane_is_ready_says_so() -> None:
    lanes = Lanes(0)
    lanes.ready = False
    registry = SessionRegistry(Settings(), lanes, Metrics())
    with pytest.raises(ProblemError, match="no lane is ready yet: the service has just started") as refused:
        await registry.create("a", b"", [], Options(idle_timeout_s=60), None)
    assert (refused.value.code, refused.value.members) == ("at-capacity", {"retry_after_s": 1.0})
    lanes.ready = True
    with pytest.raises(ProblemError, match="no place for another session"):
        await registry.create("a", b"", [], Options(idle_timeout_s=60), None)


class Stream:
    """An attachment that notes how it ended."""

    name = "s"

    def __init__(self) -> None:
        self.ends: list[int] = []

    def tell(self, message: dict[str, Any]) -> None: ...

    def end(self, code: int, reason: str) -> None:
        self.ends.append(code)

    def check(self, now: float) -> None: ...


class World:
    """A registry, its lanes and its clock."""

    def __init__(self, places: int = 2, **settings: Any) -> None:
        self.now = 1000.0
        self.lanes = Lanes(places)
        chosen = {"idle_timeout_s": 10, "attached_idle_timeout_s": 50, "max_session_s": 100, "tombstone_s": 30}
        self.settings = Settings(**chosen | settings)
        self.registry = SessionRegistry(self.settings, self.lanes, Metrics(), lambda: self.now)

    async def create(self, owner: str = "me", key: str | None = None, idle_s: float = 10) -> Session:
        options = Options(idle_timeout_s=idle_s)
        return await self.registry.create(owner, b"frame", [[1, 2, 3, 4]], options, key)


async def settle() -> None:
    """Let tasks that wait for no clock and no thread run to their end: many turns of the loop, however slow it is."""
    for _ in range(50):
        await asyncio.sleep(0)


def code_of(refused: pytest.ExceptionInfo[ProblemError]) -> tuple[str, Any]:
    return refused.value.code, refused.value.members.get("reason")


def gone(world: World, session: Session, owner: str = "me") -> tuple[str, Any]:
    with pytest.raises(ProblemError) as refused:
        world.registry.find(owner, session.id)
    return code_of(refused)


async def test_expired_sessions_make_room_for_new_ones() -> None:
    world = World(places=2)
    idle = await world.create()
    world.now += 6
    living = await world.create()
    world.now += 6
    new = await world.create()
    assert gone(world, idle) == ("session-gone", "idle")
    assert world.registry.find("me", living.id) is living
    with pytest.raises(ProblemError) as refused:
        await world.create()
    assert refused.value.code == "at-capacity"
    assert refused.value.members["retry_after_s"] > 0
    assert world.lanes.keys == {living.id, new.id}


async def test_a_full_service_says_when_a_session_ends_that_nobody_uses() -> None:
    """The earliest end of a session that nobody uses; a session with a stream may go on, so of it nothing is known."""
    world = World(places=2)
    streamed = await world.create()
    streamed.attachment = Stream()  # type: ignore[assignment]
    await world.create(idle_s=9)
    world.now += 2.5
    with pytest.raises(ProblemError, match="ends in 7 s, if not earlier") as refused:
        await world.create()
    assert refused.value.members == {"retry_after_s": 7}
    world.now += 6.4
    with pytest.raises(ProblemError) as refused:
        await world.create()
    assert refused.value.members == {"retry_after_s": 1.0}
    world.now += 1
    (await world.create()).attachment = Stream()  # type: ignore[assignment]
    with pytest.raises(ProblemError, match="all are in use") as refused:
        await world.create()
    assert refused.value.members == {"retry_after_s": 10.0}


async def test_calls_keep_session_alive_until_its_greatest_age() -> None:
    world = World()
    session = await world.create()
    for _ in range(19):
        world.now += 5
        assert world.registry.find("me", session.id) is session
    world.now += 6
    assert gone(world, session) == ("session-gone", "expired")


async def test_attached_stream_has_its_own_idle_time() -> None:
    world = World()
    session = await world.create()
    stream = Stream()
    session.attachment = stream
    world.now += 40
    world.registry.sweep()
    assert stream.ends == []
    world.now += 11
    world.registry.sweep()
    assert stream.ends == [4408]
    assert session.ended == "idle"


@pytest.mark.parametrize(("reason", "close"), [("closed", 1000), ("expired", 4410), ("lost", 4410)])
async def test_stream_closes_with_code_of_session_end(reason: str, close: int) -> None:
    world = World()
    session = await world.create()
    stream = Stream()
    session.attachment = stream
    world.registry.end(session, reason)
    assert stream.ends == [close]
    assert gone(world, session) == ("session-gone", reason)
    with pytest.raises(ProblemError) as refused:
        await session.track(QueuedFrame(b"", 1, None, None, 0.0, 0.0))
    assert code_of(refused) == ("session-gone", reason)


async def test_tombstone_is_for_owner_and_expires() -> None:
    world = World(max_tombstones=2)
    session = await world.create()
    world.registry.close("me", session.id)
    world.registry.close("me", session.id)
    assert gone(world, session) == ("session-gone", "closed")
    assert gone(world, session, "other") == ("session-not-found", None)
    with pytest.raises(ProblemError, match="session-not-found"):
        world.registry.close("other", session.id)
    world.now += 31
    assert gone(world, session) == ("session-not-found", None)
    ended = [await world.create() for _ in range(2)]
    for one in ended:
        world.registry.close("me", one.id)
    third = await world.create()
    world.registry.close("me", third.id)
    assert gone(world, ended[0]) == ("session-not-found", None)
    assert gone(world, third) == ("session-gone", "closed")


async def test_sessions_of_lost_lane_are_restored() -> None:
    world = World()
    dead, alive = await world.create(), await world.create()
    follower = asyncio.create_task(world.registry.follow_lanes())
    world.lanes.keys.discard(dead.id)
    world.lanes.lost.put_nowait(KeysLost(0, "died", (dead.id, "never-known")))
    await settle()
    follower.cancel()
    assert world.lanes.keys == {dead.id, alive.id}
    assert world.registry.find("me", dead.id) is dead


async def test_a_refused_creation_leaves_no_trace() -> None:
    world = World(places=1)
    world.lanes.refuse = "bad-box"
    for _ in range(3):
        with pytest.raises(ProblemError, match="bad-box"):
            await world.create(key="k")
    assert not world.lanes.keys
    world.lanes.refuse = None
    session = await world.create(key="k")
    assert await world.create(key="k") is session


async def test_same_idempotency_key_makes_one_session() -> None:
    world = World(places=5)
    made: Sequence[Session] = await asyncio.gather(*(world.create(key="k") for _ in range(4)))
    assert len({s.id for s in made}) == 1
    assert len(world.registry) == 1
    assert (await world.create("other", key="k")).id != made[0].id
    options = Options(Preset.PAPER, idle_timeout_s=10)
    with pytest.raises(ProblemError, match="bad-request"):
        await world.registry.create("me", b"frame", [[1, 2, 3, 4]], options, "k")
    world.now += 601
    assert (await world.create(key="k")).id != made[0].id


async def test_creation_survives_death_of_its_lane() -> None:
    world = World()
    reserve = world.lanes.reserve

    def lose(key: str, owner: str) -> None:
        world.lanes.reserve = reserve  # type: ignore[method-assign]

    world.lanes.reserve = lose  # type: ignore[method-assign]
    session = await world.create()
    assert world.registry.find("me", session.id) is session
    assert world.lanes.keys == {session.id}


async def test_one_key_gets_at_most_half_of_the_places() -> None:
    """As soon as there are others; what is set goes before it."""
    owners = 1
    world = World(places=8, lanes=2, max_sessions_per_lane=4)
    registry = world.registry = SessionRegistry(
        world.settings, world.lanes, Metrics(), lambda: world.now, lambda: owners
    )
    made = [await world.create() for _ in range(8)]
    assert (registry.quotas.sessions, registry.quotas.streams) == (8, world.settings.max_streams)
    owners = 2
    assert (registry.quotas.sessions, registry.quotas.streams) == (4, world.settings.max_streams // 2)
    for session in made[:4]:
        registry.close("me", session.id)
    with pytest.raises(ProblemError, match="over-quota: at most 4 sessions"):
        await world.create()
    for _ in range(4):
        await world.create("other")
    tight = Settings(lanes=1, max_sessions_per_lane=1)
    assert KeyQuotas(tight, lambda: 5).sessions == 1
    chosen = Settings(max_sessions_per_key=3, max_streams_per_key=2)
    assert (KeyQuotas(chosen, lambda: 5).sessions, KeyQuotas(chosen, lambda: 1).streams) == (3, 2)


async def test_next_page_begins_after_the_last_one() -> None:
    world = World(places=10)
    made = [await world.create() for _ in range(5)]
    await world.create("other")
    first, after = world.registry.list_owned("me", 0, 2)
    world.registry.close("me", made[1].id)
    assert after is not None
    second, end = world.registry.list_owned("me", after, 10)
    assert [s.id for s in first + second] == [s.id for s in made]
    assert end is None


async def test_no_new_sessions_while_draining() -> None:
    world = World()
    session = await world.create()
    world.registry.drain(lambda: 1.0)
    with pytest.raises(ProblemError, match="draining"):
        await world.create()
    assert world.registry.find("me", session.id) is session


async def test_one_operation_of_a_session_at_a_time() -> None:
    world = World()
    session = await world.create()
    running = 0
    call = world.lanes.call

    async def watched(key: str, request: Buffers) -> bytes:
        nonlocal running
        running += 1
        assert running == 1
        await asyncio.sleep(0.001)
        reply = await call(key, request)
        running -= 1
        return reply

    world.lanes.call = watched  # type: ignore[method-assign]
    frames = [QueuedFrame(b"", session.number(None), None, None, 0.0, 0.0) for _ in range(10)]
    results = await asyncio.gather(*(session.track(frame) for frame in frames))
    assert [result["seq"] for result, *_ in results] == list(range(1, 11))
    assert len(session.trajectory) == 11


async def test_remembered_idempotency_key_keeps_no_session_alive() -> None:
    """For ten minutes an idempotency key answers; the session and its past go when it ends."""
    world = World()
    session = await world.create(key="k")
    gone = weakref.ref(session)
    world.registry.close("me", session.id)
    del session
    gc.collect()
    assert gone() is None
    with pytest.raises(ProblemError, match="session-gone"):
        await world.create(key="k")


class Held(Lanes):
    """Lanes whose answers wait until they are let go."""

    def __init__(self, places: int) -> None:
        super().__init__(places)
        self.open = asyncio.Event()

    async def call(self, key: str, request: Buffers) -> bytes:
        if decode_call(memoryview(b"".join(request)))[0] == "track":
            await self.open.wait()
        return await super().call(key, request)


async def test_a_session_does_not_end_idle_while_its_frame_is_in_work() -> None:
    world = World()
    world.lanes = Held(2)
    world.registry = SessionRegistry(world.settings, world.lanes, Metrics(), lambda: world.now)
    session = await world.create()
    tracking = asyncio.create_task(session.track(QueuedFrame(b"", session.number(None), None, None, 0.0, 0.0)))
    await asyncio.sleep(0)
    world.now += 11
    world.registry.sweep()
    assert world.registry.find("me", session.id) is session
    world.now += 11
    world.lanes.open.set()
    assert (await tracking)[0]["seq"] == 1
    await session.wait_until_idle()  # some sessions take their first checkpoint after their first frame
    world.now += 9
    world.registry.sweep()
    assert session.ended is None
    world.now += 2
    world.registry.sweep()
    assert session.ended == "idle"


async def test_a_session_does_not_end_idle_while_its_frame_is_being_received() -> None:
    world = World()
    session = await world.create()
    with session.in_use():
        world.now += 11
        world.registry.sweep()
    world.now += 9
    world.registry.sweep()
    assert session.ended is None
    world.now += 2
    world.registry.sweep()
    assert session.ended == "idle"


async def test_idle_time_of_restored_session_is_cut_to_limit() -> None:
    world = World(max_idle_timeout_s=60)
    state = STATE | {"options": asdict(Options(idle_timeout_s=3600.0))}

    async def restored(key: str, request: Buffers) -> bytes:
        return encode_reply(None, state)

    world.lanes.call = restored  # type: ignore[method-assign]
    session = await world.registry.restore("me", b"snapshot", None)
    assert session.options.idle_timeout_s == 60


async def test_tenant_cannot_evict_what_is_kept_for_another() -> None:
    world = World(places=5, max_tombstones=2, max_idempotency_keys=2)
    theirs = await world.create("other", key="k")
    ended = await world.create("other")
    world.registry.close("other", ended.id)
    for number in range(5):
        world.registry.close("me", (await world.create(key=f"k{number}")).id)
    assert gone(world, ended, "other") == ("session-gone", "closed")
    assert await world.create("other", key="k") is theirs
