"""The service restarts, breaks down or is killed under its streams; they go on under the same ids."""

from __future__ import annotations

import asyncio
import os
import signal
import sqlite3
import stat
from collections.abc import AsyncIterator
from contextlib import closing
from pathlib import Path

import pytest

from service.client import AsyncClient, ConnectionLost, Frame, Problem, Result, Resumed
from service.load.clips import Clip
from service.load.own import OwnServer, ServerFailed
from service.load.usage import server_processes

from .conftest import Serve, watch
from .test_main_job import assert_same, in_process


@pytest.fixture
def state(tmp_path: Path) -> Path:
    return tmp_path / "state"


async def paced(clip: Clip, count: int, fps: float = 50.0) -> AsyncIterator[Frame]:
    """Frames at a rate; ``ts`` is their index in the clip."""
    for index in range(1, count):
        yield Frame(clip.frame(index), ts=index)
        await asyncio.sleep(1 / fps)


async def kill(server: OwnServer, how: signal.Signals) -> None:
    os.kill(server.pid, how)
    while server.exit_code is None:
        await asyncio.sleep(0.02)


async def test_streams_go_on_through_a_restart(own_server: Serve, clip: Clip, state: Path) -> None:
    """SIGTERM under streams in both modes; the next process has every session, box for box, and the past."""
    server = own_server(state_dir=state, lanes=2, checkpoint_every_frames=7)
    said = in_process(clip, [clip.box])
    async with AsyncClient(server.url) as client:
        lossless, latest, idle = [await client.create(clip.frames[0], clip.box, label="kept") for _ in range(3)]
        await idle.track(clip.frames[1])
        told: list[Resumed] = []
        streams = [
            lossless.stream(paced(clip, 60), mode="lossless", on_resumed=told.append),
            latest.stream(paced(clip, 60), on_resumed=told.append),
        ]
        got: list[list[Result]] = [[await anext(stream) for _ in range(5)] for stream in streams]
        collecting = [asyncio.create_task(_all(stream)) for stream in streams]
        await kill(server, signal.SIGTERM)
        assert server.exit_code == 0
        assert "Traceback" not in server.log
        await asyncio.to_thread(server.start)
        for results, rest in zip(got, await asyncio.gather(*collecting), strict=True):
            results += rest
        assert [result.ts for result in got[0]] == list(range(1, 60))
        for result in got[0]:
            assert_same(result.target, said[int(result.ts or 0) - 1][0])
        assert [resumed.lost_after for resumed in told] == [None, None]
        assert [r.target.box for r in await lossless.trajectory()][1:] == [r.target.box for r in got[0]]
        info = await idle.refresh()
        assert (info.label, info.seq, info.size) == ("kept", 1, clip.size)
        assert_same((await idle.track(clip.frames[2])).target, said[1][0])
    with watch(server) as log:
        server.stop()
        assert log.lines(event="sessions parked")[0]["whole"] == 3


async def _all(stream: AsyncIterator[Result]) -> list[Result]:
    return [result async for result in stream]


async def test_a_killed_service_loses_no_more_than_it_says(own_server: Serve, clip: Clip, state: Path) -> None:
    """kill -9: every frame of a lossless stream is answered, and the client is told what is forgotten."""
    every = 10
    server = own_server(state_dir=state, checkpoint_every_frames=every)
    async with AsyncClient(server.url) as client:
        session, young = [await client.create(clip.frames[0], clip.box) for _ in range(2)]
        told: list[Resumed] = []
        stream = session.stream(paced(clip, 60), mode="lossless", on_resumed=told.append)
        got = [await anext(stream) for _ in range(25)]
        collecting = asyncio.create_task(_all(stream))
        await asyncio.sleep(0.2)
        await kill(server, signal.SIGKILL)
        await asyncio.to_thread(server.start)
        got += await collecting
        assert [result.ts for result in got] == list(range(1, 60))
        assert len(told) == 1
        assert told[0].seq >= 25 - 2 * every  # what is written may lag behind what is kept
        assert told[0].lost_after in (None, told[0].seq)  # None if the last checkpoint was of the last result
        assert (await young.refresh()).seq == 0
        assert_same((await young.track(clip.frames[1])).target, in_process(clip, [clip.box])[0][0])
        past = [result.seq for result in await session.trajectory()]
        assert past == sorted(set(past))


async def test_a_client_that_reads_itself_is_told_of_the_loss(own_server: Serve, clip: Clip, state: Path) -> None:
    server = own_server(state_dir=state)
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        for index in (1, 2, 3):
            await session.track(clip.frames[index])
        await asyncio.sleep(0.5)
        await kill(server, signal.SIGKILL)
        await asyncio.to_thread(server.start)
        async with session.stream(mode="lossless") as stream:
            assert stream.ready.lost_after is not None
            assert stream.ready.lost_after == stream.ready.session.seq <= 3
            await stream.send(clip.frames[4])
            await anext(stream)
        async with session.stream(mode="lossless") as stream:
            assert stream.ready.lost_after is None


async def test_files_are_for_their_owner_alone(own_server: Serve, clip: Clip, state: Path) -> None:
    server = own_server(state_dir=state)
    async with AsyncClient(server.url) as client:
        await client.create(clip.frames[0], clip.box)
        assert stat.S_IMODE(state.stat().st_mode) == 0o700
        files = list(state.iterdir())
        assert files
        assert {stat.S_IMODE(file.stat().st_mode) for file in files} == {0o600}


async def test_ended_sessions_stay_ended_and_foreign_ones_foreign(own_server: Serve, clip: Clip, state: Path) -> None:
    keys = ["a-key-of-one-tenant", "the-key-of-another"]
    server = own_server(state_dir=state, api_keys=",".join(keys))
    async with AsyncClient(server.url, key=keys[0]) as client, AsyncClient(server.url, key=keys[1]) as other:
        ended, kept = [await client.create(clip.frames[0], clip.box) for _ in range(2)]
        await ended.close()
        server.stop()
        await asyncio.to_thread(server.start)
        assert (await kept.refresh()).seq == 0
        for gone in (ended.refresh(), other.session(kept.id)):
            with pytest.raises(Problem) as refused:
                await gone
            assert refused.value.code == "session-not-found"


async def test_a_damaged_session_is_told_and_the_others_live(own_server: Serve, clip: Clip, state: Path) -> None:
    server = own_server(state_dir=state)
    async with AsyncClient(server.url) as client:
        damaged, kept = [await client.create(clip.frames[0], clip.box) for _ in range(2)]
        server.stop()
        with closing(sqlite3.connect(state / "sessions.sqlite3", isolation_level=None)) as db:
            (data,) = db.execute("SELECT data FROM session WHERE id = ?", (damaged.id,)).fetchone()
            flipped = bytearray(data)
            flipped[len(data) // 2] ^= 1
            db.execute("UPDATE session SET data = ? WHERE id = ?", (bytes(flipped), damaged.id))
        await asyncio.to_thread(server.start)
        with pytest.raises(Problem) as gone:
            await damaged.refresh()
        assert (gone.value.code, gone.value.reason) == ("session-gone", "lost")
        assert "damaged" in gone.value.detail
        await kept.track(clip.frames[1])


def test_state_of_another_process_or_version_is_not_touched(own_server: Serve, state: Path) -> None:
    server = own_server(state_dir=state)
    with pytest.raises(ServerFailed, match="another process uses it"):
        OwnServer(state_dir=state, lanes=1).start()
    server.stop()
    with closing(sqlite3.connect(state / "sessions.sqlite3", isolation_level=None)) as db:
        db.execute("PRAGMA user_version = 99")
    with pytest.raises(ServerFailed, match="version 99 is not read here"):
        server.start()


async def test_the_second_sigterm_stops_at_once_and_keeps_what_is_saved(
    own_server: Serve, clip: Clip, state: Path
) -> None:
    """The first waits for a lane that hangs; the second does not."""
    server = own_server(state_dir=state, operation_deadline_s=30, drain_grace_s=60)
    async with AsyncClient(server.url, timeout_s=60) as client:
        session = await client.create(clip.frames[0], clip.box)
        os.kill(server_processes(server.pid)["lane 0"], signal.SIGSTOP)
        tracking = asyncio.create_task(session.track(clip.frames[1]))
        await asyncio.sleep(0.2)
        os.kill(server.pid, signal.SIGTERM)
        while "draining" not in server.log:
            await asyncio.sleep(0.02)
        await kill(server, signal.SIGTERM)
        with pytest.raises(ConnectionLost):
            await tracking
        assert "Traceback" not in server.log
        await asyncio.to_thread(server.start)
        assert (await session.refresh()).seq == 0
        await session.track(clip.frames[1])
