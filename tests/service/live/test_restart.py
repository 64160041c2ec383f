"""The service restarts, breaks down or is killed under its streams; they go on under the same ids."""

from __future__ import annotations

import asyncio
import os
import resource
import secrets
import signal
import sqlite3
import stat
import time
from collections.abc import AsyncIterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import httpx2
import msgpack
import pytest

from service.cli.serve import NOT_WRITTEN
from service.client import AsyncClient, ConnectionLost, Frame, Problem, Result, Resumed
from service.load.clips import Clip
from service.load.own import OwnServer, ServerFailed
from service.load.usage import server_processes
from tests.service.unit.test_sqlite_store import Before, as_before, remains

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


async def wait_for_metric(server: OwnServer, series: str, least: float) -> None:
    """Wait until a series of the metrics is that high."""
    async with httpx2.AsyncClient(base_url=server.url) as http, asyncio.timeout(60):
        while metric(await http.get("/metrics"), series) < least:
            await asyncio.sleep(0.02)


def metric(response: httpx2.Response, series: str) -> float:
    """Return the value of a series; 0 if there is none yet."""
    lines = (line.rpartition(" ") for line in response.text.splitlines())
    return next((float(value) for name, _, value in lines if name == series), 0.0)


async def test_streams_go_on_through_a_restart(own_server: Serve, clip: Clip, state: Path) -> None:
    """SIGTERM under streams in both modes; the next process has every session, box for box, and the past."""
    server = own_server(state_dir=state, lanes=2, checkpoint_every_frames=7)
    said = in_process(clip, [clip.box])
    async with AsyncClient(server.url) as client:
        lossless, latest, idle = [await client.create(clip.frames[0], clip.box, label="kept") for _ in range(3)]
        await idle.track(clip.frames[1])
        resumptions: list[Resumed] = []
        streams = [
            lossless.stream(paced(clip, 60), mode="lossless", on_resumed=resumptions.append),
            latest.stream(paced(clip, 60), on_resumed=resumptions.append),
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
        assert [resumed.lost_after for resumed in resumptions] == [None, None]
        assert [r.target.box for r in await lossless.trajectory()][1:] == [r.target.box for r in got[0]]
        info = await idle.refresh()
        assert (info.label, info.seq, info.size) == ("kept", 1, clip.size)
        assert_same((await idle.track(clip.frames[2])).target, said[1][0])
    with watch(server) as log:
        server.stop()
        assert log.lines(event="sessions saved")[0]["whole"] == 3


async def _all(stream: AsyncIterator[Result]) -> list[Result]:
    return [result async for result in stream]


async def test_a_killed_service_loses_no_more_than_it_says(own_server: Serve, clip: Clip, state: Path) -> None:
    """kill -9: every frame of a lossless stream is answered, and the client is told what is forgotten."""
    every = 10
    server = own_server(state_dir=state, checkpoint_every_frames=every)
    async with AsyncClient(server.url) as client:
        session, young = [await client.create(clip.frames[0], clip.box) for _ in range(2)]
        resumptions: list[Resumed] = []
        stream = session.stream(paced(clip, 60), mode="lossless", on_resumed=resumptions.append)
        got = [await anext(stream) for _ in range(25)]
        collecting = asyncio.create_task(_all(stream))
        await asyncio.sleep(0.2)
        await kill(server, signal.SIGKILL)
        await asyncio.to_thread(server.start)
        got += await collecting
        assert [result.ts for result in got] == list(range(1, 60))
        assert len(resumptions) == 1
        assert resumptions[0].seq >= 25 - 2 * every  # what is written may lag behind what is kept
        assert resumptions[0].lost_after in (
            None,
            resumptions[0].seq,
        )  # None if the last checkpoint was of the last result
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
        await wait_for_metric(server, "mfcmt_state_write_seconds_count", 1)
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
        await wait_for_metric(server, 'mfcmt_frames_received_total{via="http"}', 1)
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


async def test_sessions_older_than_their_idle_time_go_on(own_server: Serve, clip: Clip, state: Path) -> None:
    """A stream of some minutes has one, and most streams do: through SIGTERM, kill -9 and another SIGTERM."""
    idle_s = 8.0
    server = own_server(state_dir=state, idle_timeout_s=idle_s, checkpoint_every_frames=5)
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        begun = time.monotonic()
        got: list[Result] = []
        collecting = asyncio.create_task(_into(got, session.stream(paced(clip, 10_000, fps=5.0), mode="lossless")))
        for how in (signal.SIGTERM, signal.SIGKILL, signal.SIGTERM):
            while time.monotonic() < begun + idle_s + 1 or not got:
                await asyncio.sleep(0.1)
            await kill(server, how)
            await asyncio.to_thread(server.start)
            await _another(got)
        collecting.cancel()
        assert [result.ts for result in got] == list(range(1, len(got) + 1))


async def _into(got: list[Result], stream: AsyncIterator[Result]) -> None:
    while True:
        got.append(await anext(stream))


async def _another(got: list[Result]) -> None:
    had = len(got)
    async with asyncio.timeout(60):
        while len(got) == had:
            await asyncio.sleep(0.05)


async def test_state_of_the_version_before_is_taken_up(own_server: Serve, clip: Clip, state: Path) -> None:
    """A file with remains of ended sessions, from before they were erased; box for box as a session made now."""
    sid, box = "HoozkC9XeBJ2fHyJqnOOqIkP", [float(value) for value in clip.box]
    front = {
        "options": ["default", "reject", "kept", False, 300.0],
        "created_at": datetime.now(UTC).isoformat(),
        "seq": 0,
        "last_number": 0,
        "size": list(clip.size),
        "region": [0, 0, *clip.size],
        "rows": [[0, box, "tracking", None, None, None, None, True, 1.0]],
    }
    args = {"options": {"preset": "default", "on_resize": "reject", "maps": False}, "boxes": [box]}
    past = msgpack.packb([None, front["size"], front["region"], front["rows"]])
    kept = Before(sid, "anyone", front, "create", args, clip.frames[0], past)
    ended = [secrets.token_bytes(50_000) for _ in range(8)]  # rendered frames have pieces in common
    as_before(state, [kept], [replace(kept, id=f"e{n}", data=data) for n, data in enumerate(ended)])
    assert remains(state, ended) > 0
    server = own_server(state_dir=state)
    async with AsyncClient(server.url) as client:
        session = await client.session(sid)
        assert (session.info.label, session.info.seq) == ("kept", 0)
        twin = await client.create(clip.frames[0], clip.box)
        for frame in clip.frames[1:4]:
            assert (await session.track(frame)).target == (await twin.track(frame)).target
        assert [result.seq for result in await session.trajectory()] == [0, 1, 2, 3]
        assert remains(state, ended) == 0


async def test_ended_sessions_leave_no_frame_on_disk(own_server: Serve, clip: Clip, state: Path) -> None:
    server = own_server(state_dir=state, checkpoint_every_frames=3)
    async with AsyncClient(server.url) as client:
        sessions = [await client.create(clip.frames[0], clip.box) for _ in range(3)]
        sent = clip.frames[:30]
        for start, session in enumerate(sessions):
            for frame in sent[1 + start :: 3]:
                await session.track(frame)
        async with asyncio.timeout(60):
            while not remains(state, sent):
                await asyncio.sleep(0.02)
        for session in sessions:
            await session.close()
        async with asyncio.timeout(60):
            while remains(state, sent):
                await asyncio.sleep(0.2)
    server.stop()
    assert remains(state, sent) == 0


async def test_a_full_disk_ends_the_service_with_a_code_and_a_line(own_server: Serve, clip: Clip, state: Path) -> None:
    """Frames are tracked all the same; the log says it once, and the exit code that something is missing."""
    server = own_server(state_dir=state, checkpoint_every_frames=3, operation_deadline_s=1)
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        _, most = resource.prlimit(server.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(server.pid, resource.RLIMIT_FSIZE, (1 << 18, most))
        for frame in clip.frames[1:20]:
            await session.track(frame)
        async with asyncio.timeout(60):
            while "sessions cannot be written" not in server.log:
                await asyncio.sleep(0.05)
        await kill(server, signal.SIGTERM)
    assert server.exit_code == NOT_WRITTEN
    assert server.log.count('"event": "sessions cannot be written"') == 1
    assert "mfcmt serve: some sessions could not be written" in server.log
    assert "Traceback" not in server.log
    await asyncio.to_thread(server.start)
