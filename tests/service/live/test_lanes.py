"""A lane that dies or hangs: noticed, replaced, told to whom it concerns, and nobody else notices."""

from __future__ import annotations

import asyncio
import os
import signal
import time

import pytest

from service.client import AsyncClient, AsyncSession, Problem, Result
from service.load.clips import Clip
from service.load.own import OwnServer
from service.load.usage import server_processes

from .conftest import Serve, watch
from .raw import attach
from .test_main_job import assert_same, in_process


def lanes_of(server: OwnServer) -> set[int]:
    return {pid for role, pid in server_processes(server.pid).items() if role.startswith("lane")}


async def reason_of_end(session: AsyncSession) -> str | None:
    """Why the session has ended."""
    with pytest.raises(Problem) as gone:
        await session.refresh()
    assert (gone.value.code, gone.value.status) == ("session-gone", 410)
    return gone.value.reason


async def replaced(server: OwnServer, before: set[int]) -> None:
    give_up = time.monotonic() + 60
    while len(lanes_of(server)) < len(before) or lanes_of(server) == before:
        assert time.monotonic() < give_up
        await asyncio.sleep(0.05)


async def test_killed(serve: Serve, clip: Clip) -> None:
    server = serve(lanes=2, max_sessions_per_lane=1)
    said = in_process(clip, [clip.box])
    with watch(server, errors=1) as log:
        async with AsyncClient(server.url) as client:
            sessions = [await client.create(clip.frames[0], clip.box) for _ in range(2)]
            before = lanes_of(server)
            async with attach(server, sessions[0].id) as one, attach(server, sessions[1].id) as two:
                for raw in (one, two):
                    await raw.frame(clip.frames[1])
                    assert_same(Result.of(await raw.receive()).target, said[0][0])
                os.kill(min(before), signal.SIGKILL)
                ended = {0: asyncio.create_task(one.closed()), 1: asyncio.create_task(two.closed())}
                done, _ = await asyncio.wait(ended.values(), timeout=20, return_when=asyncio.FIRST_COMPLETED)
                assert [task.result() for task in done] == [4410]
                gone = next(index for index, task in ended.items() if task in done)
                assert await reason_of_end(sessions[gone]) == "lost"
                with pytest.raises(Problem) as refused:
                    await sessions[gone].track(clip.frames[2])
                assert refused.value.reason == "lost"
                # The other lane's stream has not noticed.
                ended[1 - gone].cancel()
                await asyncio.gather(ended[1 - gone], return_exceptions=True)
                raw = (one, two)[1 - gone]
                for index in range(2, 10):
                    await raw.frame(clip.frames[index])
                    assert_same(Result.of(await raw.receive()).target, said[index - 1][0])
            await replaced(server, before)
            fresh = await _create_when_there_is_room(client, clip)
            assert_same((await fresh.track(clip.frames[1])).target, said[0][0])
        assert len(log.lines(event="lane lost")) == 1


async def _create_when_there_is_room(client: AsyncClient, clip: Clip) -> AsyncSession:
    give_up = time.monotonic() + 30
    while True:
        try:
            return await client.create(clip.frames[0], clip.box)
        except Problem as full:
            if full.code != "at-capacity" or time.monotonic() > give_up:
                raise
            await asyncio.sleep(0.05)


async def test_killed_with_frames_in_work(serve: Serve, clip: Clip) -> None:
    """Every call that was in the lane is answered; none hangs."""
    server = serve()
    with watch(server, errors=1):
        async with AsyncClient(server.url) as client:
            sessions = [await client.create(clip.frames[0], clip.box) for _ in range(4)]
            (lane,) = lanes_of(server)
            os.kill(lane, signal.SIGSTOP)
            calls = [asyncio.create_task(session.track(clip.frames[1])) for session in sessions]
            await asyncio.sleep(0.2)
            os.kill(lane, signal.SIGKILL)
            answers = await asyncio.wait_for(asyncio.gather(*calls, return_exceptions=True), 20)
            assert [(a.code, a.reason) for a in answers if isinstance(a, Problem)] == [("session-gone", "lost")] * 4
            await replaced(server, {lane})
            await _create_when_there_is_room(client, clip)


async def test_hung(serve: Serve, clip: Clip) -> None:
    """A lane that stands still past the deadline is replaced; its call is told so."""
    server = serve(operation_deadline_s=0.5)
    with watch(server, errors=1):
        async with AsyncClient(server.url) as client:
            session = await client.create(clip.frames[0], clip.box)
            other = await client.create(clip.frames[0], clip.box)
            (lane,) = lanes_of(server)
            os.kill(lane, signal.SIGSTOP)
            with pytest.raises(Problem) as late:
                await session.track(clip.frames[1])
            assert (late.value.code, late.value.status) == ("deadline-exceeded", 504)
            assert await reason_of_end(session) == "lost"
            assert await reason_of_end(other) == "lost"
            await replaced(server, {lane})
            await _create_when_there_is_room(client, clip)


async def test_lanes_end_with_the_front(serve: Serve, clip: Clip) -> None:
    """Also with a kill -9 of the front, and also lanes that are busy."""
    server = serve(lanes=2)
    async with AsyncClient(server.url) as client:
        await client.create(clip.frames[0], clip.box)
        processes = set(server_processes(server.pid).values())
        os.kill(server.pid, signal.SIGKILL)
        give_up = time.monotonic() + 20
        while any(_alive(pid) for pid in processes):
            assert time.monotonic() < give_up
            await asyncio.sleep(0.05)
            _ = server.exit_code  # reaps the front


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
