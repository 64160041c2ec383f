"""Frames that end their lane: the sender's session ends with a clear error, nobody else's."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable

import pytest

from service.client import AsyncClient, AsyncSession, Problem
from service.load.clips import Clip
from service.load.own import OwnServer
from service.load.usage import server_processes
from service.protocol.problems import NO_LANE
from tests.service.live.test_main_job import assert_same, in_process
from tests.service.wire.conftest import Wire

from .conftest import FAULT, GROW, POISON, SLEEP

Serve = Callable[..., OwnServer]


@pytest.mark.parametrize(("poison", "said"), [(POISON, "ended its worker twice"), (SLEEP, "took too long twice")])
async def test_a_poisonous_frame_ends_its_session_alone(
    misbehaving: Serve, clip: Clip, poison: bytes, said: str
) -> None:
    server = misbehaving(lanes=1, operation_deadline_s=1.5)
    results = in_process(clip, [clip.box])
    async with AsyncClient(server.url) as client:
        healthy, sick = [await client.create(clip.frames[0], clip.box) for _ in range(2)]
        async with healthy.stream(mode="lossless") as stream:
            await sick.track(clip.frames[1])
            await stream.send(clip.frames[1])
            tracking = asyncio.create_task(sick.track(clip.frames[2] + poison))
            for index in (2, 3, 4):
                await stream.send(clip.frames[index])
            for index in range(4):
                assert_same((await anext(stream)).target, results[index][0])
            with pytest.raises(Problem) as gone:
                await tracking
            assert (gone.value.code, gone.value.reason) == ("session-gone", "lost")
            assert f"frame 2 {said}" in gone.value.detail
            with pytest.raises(Problem, match=said):
                await sick.refresh()
            await stream.send(clip.frames[5])
            assert_same((await anext(stream)).target, results[4][0])
        assert await _restarts(server) == 2


async def test_a_poisonous_frame_closes_its_stream(misbehaving: Serve, clip: Clip) -> None:
    server = misbehaving(lanes=1)
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        with pytest.raises(Problem, match="frame 1 ended its worker twice") as gone:
            async for _ in session.stream([clip.frames[1] + POISON, clip.frames[2]], mode="lossless"):
                pass
        assert gone.value.code == "session-gone"


async def test_a_session_does_not_begin_with_poison(misbehaving: Serve, clip: Clip) -> None:
    server = misbehaving(lanes=1)
    async with AsyncClient(server.url) as client:
        with pytest.raises(Problem, match="ended its worker") as refused:
            await client.create(clip.frames[0] + POISON, clip.box)
        assert refused.value.code == "internal"
        await _until(Wire(server), 200)
        await client.create(clip.frames[0], clip.box)


async def test_a_fault_leaves_the_session_as_it_was(misbehaving: Serve, clip: Clip) -> None:
    """The fault came after the trackers had moved on; the frame is refused and the next one does not notice."""
    server = misbehaving(lanes=1)
    results = in_process(clip, [clip.box])
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        await session.track(clip.frames[1])
        with pytest.raises(Problem) as refused:
            await session.track(clip.frames[30] + FAULT)
        assert refused.value.code == "internal"
        assert_same((await session.track(clip.frames[2])).target, results[1][0])


async def test_a_lane_that_outgrows_its_limit(misbehaving: Serve, clip: Clip) -> None:
    server = misbehaving(lanes=1, max_lane_rss_bytes=512 << 20, operation_deadline_s=60)
    results = in_process(clip, [clip.box])
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        frames = [clip.frames[1], clip.frames[2] + GROW, *clip.frames[3:10]]
        got = [result async for result in session.stream(frames, mode="lossless")]
        for result, said in zip(got, results, strict=False):
            assert_same(result.target, said[0])
        assert len(got) == 9
        while await _restarts(server) == 0:
            await asyncio.sleep(0.05)
        assert 'mfcmt_lane_restarts_total{cause="memory"} 1.0' in (await Wire(server).http.get("/metrics")).text
        assert_same((await session.track(clip.frames[10])).target, results[9][0])


async def test_lanes_that_keep_dying_turn_readiness_off(own_server: Serve, clip: Clip) -> None:
    """Sessions wait, their frames are refused in time, and all go on when the lanes live."""
    server = own_server(lanes=1, recovery_timeout_s=0.3)
    results = in_process(clip, [clip.box])
    wire = Wire(server)
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        killing = asyncio.create_task(_keep_killing(server))
        try:
            answer = await _until(wire, 503)
            assert (answer["code"], answer["detail"]) == ("at-capacity", "lanes die again and again")
            assert 'mfcmt_lane_failing{lane="0"} 1.0' in (await wire.http.get("/metrics")).text
            with pytest.raises(Problem) as refused:
                await _track_until_refused(session, clip.frames[0])
        finally:
            killing.cancel()
        await _until(wire, 200)
        if refused.value.code == "session-gone":  # a frame of it was at work in two lanes that were killed
            return
        assert refused.value.code == "at-capacity"
        assert refused.value.retry_after_s
        known = (await session.refresh()).seq
        said = (await session.track(clip.frames[1])).target
        if known == 0:
            assert_same(said, results[0][0])


async def _track_until_refused(session: AsyncSession, frame: bytes) -> None:
    while True:
        await session.track(frame)


async def _keep_killing(server: OwnServer) -> None:
    while True:
        for role, pid in server_processes(server.pid).items():
            if role.startswith("lane"):
                os.kill(pid, signal.SIGKILL)
        await asyncio.sleep(0.02)


async def _until(wire: Wire, status: int) -> dict[str, str]:
    give_up = time.monotonic() + 40
    while time.monotonic() < give_up:
        answer = await wire.http.get("/readyz")
        problem: dict[str, str] = answer.json()
        if answer.status_code == status and problem.get("detail") != NO_LANE:
            return problem
        await asyncio.sleep(0.02)
    raise AssertionError(f"readiness is never {status}")


async def _restarts(server: OwnServer) -> float:
    metrics = (await Wire(server).http.get("/metrics")).text
    lines = [line for line in metrics.splitlines() if line.startswith("mfcmt_lane_restarts_total{")]
    return sum(float(line.split()[1]) for line in lines)
