"""Sessions that one process leaves in the state directory are taken up by the next one."""

from __future__ import annotations

import asyncio
import os
import signal
import sqlite3
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest

from service.app import create_app
from service.lanes.interface import Place
from service.server import make_server
from service.sessions.session import Session
from service.sessions.state_file import FILE
from service.settings import Settings

from .test_recovery import Keeping
from .test_registry import Lanes, QueuedFrame, World, gone, settle


async def left_behind(world: World, *, age_s: float = 0.0) -> Session:
    """A session of that age, in use all the time; its registry has parked it."""
    session = await world.create()
    session.created -= age_s
    session.created_at -= timedelta(seconds=age_s)
    for _ in range(int(age_s // 5)):
        world.now += 5
        world.registry.find("me", session.id)
    await world.registry.save_all()
    return session


@pytest.mark.parametrize("down_s", [0, 1000], ids=["at once", "after a while"])
async def test_a_session_older_than_its_idle_time_is_taken_up(tmp_path: Path, down_s: float) -> None:
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    session = await left_behind(first, age_s=25)
    second = Keeping(state_dir=str(tmp_path))
    second.now = first.now + down_s
    await second.registry.load()
    assert second.registry.find("me", session.id).seq == session.seq
    second.now += 9
    second.registry.sweep()
    assert second.registry.find("me", session.id).ended is None
    second.now += 11
    assert gone(second, session) == ("session-gone", "idle")
    await second.registry.save_all()


async def test_time_spent_down_counts_for_the_absolute_end(tmp_path: Path) -> None:
    """By the clock on the wall: the monotonic one may begin anew with the machine."""
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    old, young = await first.create(), await first.create()
    old.created_at -= timedelta(seconds=101)
    young.created_at -= timedelta(seconds=69)
    await first.registry.save_all()
    second = Keeping(state_dir=str(tmp_path))
    await second.registry.load()
    assert gone(second, old) == ("session-gone", "expired")
    assert second.registry.find("me", young.id).ended is None
    second.now += 35
    assert gone(second, young) == ("session-gone", "expired")
    await second.registry.save_all()


async def test_the_idle_time_of_a_session_that_is_taken_up_is_cut_to_the_limit(tmp_path: Path) -> None:
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    session = await first.create(idle_s=3000)
    await first.registry.save_all()
    second = Keeping(state_dir=str(tmp_path), max_idle_timeout_s=60)
    await second.registry.load()
    assert second.registry.find("me", session.id).options.idle_timeout_s == 60
    await second.registry.save_all()


async def test_loss_is_reported_also_after_another_restart(tmp_path: Path) -> None:
    """The client did not come back between a breakdown and the next stop."""
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    session = await first.create()
    assert first.registry.store._database is not None
    first.registry.store._database.flush(10)
    first.registry.store._database.close()  # as if it had been killed: nothing says that the session is whole
    second = Keeping(state_dir=str(tmp_path))
    await second.registry.load()
    assert second.registry.find("me", session.id).lost_after == 0
    await second.registry.save_all()
    third = Keeping(state_dir=str(tmp_path))
    await third.registry.load()
    again = third.registry.find("me", session.id)
    assert again.lost_after == 0
    await third.track(again)
    assert again.lost_after is None
    await third.registry.save_all()
    fourth = Keeping(state_dir=str(tmp_path))
    await fourth.registry.load()
    assert fourth.registry.find("me", session.id).lost_after is None
    await fourth.registry.save_all()


async def test_a_stop_before_lanes_are_ready_loses_nothing(tmp_path: Path) -> None:
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    session = await left_behind(first)
    second = Keeping(state_dir=str(tmp_path), operation_deadline_s=0.01)

    async def never(key: str, owner: str) -> Place:
        await asyncio.sleep(60)
        raise AssertionError

    second.lanes.regain = never  # type: ignore[method-assign]
    await second.registry.load()
    await settle()
    await second.registry.save_all()
    third = Keeping(state_dir=str(tmp_path))
    await third.registry.load()
    assert third.registry.find("me", session.id).lost_after is None
    await third.registry.save_all()


async def test_opening_the_state_directory_changes_nothing(tmp_path: Path) -> None:
    """A process that ends between opening it and taking the sessions over has lost nothing."""
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    session = await left_behind(first)
    second = Keeping(state_dir=str(tmp_path))
    second.registry.store.open()
    assert second.registry.store._database is not None
    second.registry.store._database.close()
    third = Keeping(state_dir=str(tmp_path))
    await third.registry.load()
    assert third.registry.find("me", session.id).lost_after is None
    await third.registry.save_all()


async def test_a_start_that_fails_loses_nothing(tmp_path: Path) -> None:
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    session = await left_behind(first)

    class Broken(Lanes):
        async def start(self) -> None:
            raise OSError("no process can be made")

    app = create_app(Settings(state_dir=str(tmp_path)), lanes=Broken(2))
    with pytest.raises(OSError, match="no process"):
        async with app.router.lifespan_context(app):
            raise AssertionError
    third = Keeping(state_dir=str(tmp_path))
    await third.registry.load()
    assert third.registry.find("me", session.id).lost_after is None
    await third.registry.save_all()


def test_a_signal_in_the_middle_of_the_start_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As soon as the server hears signals, before it has started anything."""
    first = Keeping(state_dir=str(tmp_path))
    session = asyncio.run(_loaded_and_left(first))
    server = make_server(create_app(Settings(state_dir=str(tmp_path), port=0, drain_grace_s=0), lanes=Lanes(2)))
    load = server.config.load

    def signalled() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        load()

    monkeypatch.setattr(server.config, "load", signalled)
    asyncio.run(server.serve())
    third = Keeping(state_dir=str(tmp_path))

    async def look() -> int | None:
        await third.registry.load()
        lost_after = third.registry.find("me", session.id).lost_after
        await third.registry.save_all()
        return lost_after

    assert asyncio.run(look()) is None


async def _loaded_and_left(world: World) -> Session:
    await world.registry.load()
    return await left_behind(world)


async def test_a_session_is_not_idle_until_it_is_restored(tmp_path: Path) -> None:
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    session = await left_behind(first)
    second = Keeping(state_dir=str(tmp_path))
    ready = asyncio.Event()
    regain = second.lanes.regain

    async def late(key: str, owner: str) -> Place:
        await ready.wait()
        return await regain(key, owner)

    second.lanes.regain = late  # type: ignore[method-assign]
    await second.registry.load()
    await settle()
    second.now += 15
    second.registry.sweep()
    ready.set()
    await settle()
    second.now += 9
    taken_up = second.registry.find("me", session.id)
    frame = QueuedFrame(b"", taken_up.number(None), None, None, 0.0, 0.0)
    assert (await taken_up.track(frame))[0]["seq"] == session.seq + 1
    await second.registry.save_all()


async def test_damaged_session_is_reported_to_owner_and_deleted(tmp_path: Path) -> None:
    first = Keeping(state_dir=str(tmp_path))
    await first.registry.load()
    damaged, kept = await first.create(), await first.create()
    await first.registry.save_all()
    with closing(sqlite3.connect(tmp_path / FILE, isolation_level=None)) as db:
        db.execute("UPDATE session SET checksum = checksum + 1 WHERE id = ?", (damaged.id,))
    second = Keeping(state_dir=str(tmp_path))
    await second.registry.load()
    assert gone(second, damaged) == ("session-gone", "lost")
    assert second.registry.find("me", kept.id).ended is None
    await second.registry.save_all()
    with closing(sqlite3.connect(tmp_path / FILE)) as db:
        assert db.execute("SELECT id FROM session").fetchall() == [(kept.id,)]
