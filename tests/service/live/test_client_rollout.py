"""The Python client while its service is replaced and others stand in for it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.client import AsyncClient, Client, Frame, Problem, Result, Resumed
from service.load.clips import Clip

from .conftest import Serve, watch
from .rollout import Rollout
from .test_client import drained, paced

FRAMES = 30


def slowly(clip: Clip, count: int) -> Iterator[Frame]:
    for index in range(1, count):
        time.sleep(0.03)
        yield Frame(clip.frame(index), ts=index)


async def test_a_stream_goes_on_when_its_service_is_back(own_server: Serve, clip: Clip, tmp_path: Path) -> None:
    """404 of a replica and of a proxy, 502, 503, refused connections: no result is lost or changed."""
    rollout = Rollout(own_server, tmp_path)
    async with rollout.cable, AsyncClient(rollout.cable.url, timeout_s=10) as client:
        session, twin = [await client.create(clip.frames[0], clip.box) for _ in range(2)]
        undisturbed = [r.target async for r in twin.stream(clip.frames[1:FRAMES], mode="lossless")]
        resumptions: list[Resumed] = []
        frames = (Frame(clip.frame(index), ts=index) for index in range(1, FRAMES))
        stream = session.stream(frames, mode="lossless", on_resumed=resumptions.append)
        results = [await anext(stream) for _ in range(5)]
        with watch(rollout.first):
            async with asyncio.TaskGroup() as both:
                rest = both.create_task(drained(stream))
                both.create_task(rollout.happen())
        results += rest.result()
        assert [result.ts for result in results] == list(range(1, FRAMES))
        assert [result.target for result in results] == undisturbed
        assert resumptions[-1].lost_after is None
        assert (await session.refresh()).seq == results[-1].seq


async def test_a_stream_without_asyncio_goes_on_too(own_server: Serve, clip: Clip, tmp_path: Path) -> None:
    rollout = Rollout(own_server, tmp_path)
    five = asyncio.Event()
    loop = asyncio.get_running_loop()

    def work() -> list[Result]:
        with Client(rollout.cable.url, timeout_s=10) as client, client.create(clip.frames[0], clip.box) as session:
            results = []
            for result in session.stream(slowly(clip, FRAMES), mode="lossless"):
                results.append(result)
                if len(results) == 5:
                    loop.call_soon_threadsafe(five.set)
            return results

    async with rollout.cable:
        async with asyncio.TaskGroup() as both:
            working = both.create_task(asyncio.to_thread(work))
            await five.wait()
            both.create_task(rollout.happen())
        assert [result.ts for result in working.result()] == list(range(1, FRAMES))


async def test_results_missed_are_asked_for_until_the_service_answers(
    own_server: Serve, clip: Clip, tmp_path: Path
) -> None:
    """The stream is back, and the call that fetches what it missed meets a replica that does not know the session."""
    rollout = Rollout(own_server, tmp_path)
    async with rollout.cable, AsyncClient(rollout.cable.url, timeout_s=10) as client:
        session = await client.create(clip.frames[0], clip.box)
        stream = session.stream(mode="lossless")
        fetch, fetches = stream._missed, 0

        async def missed(after: int) -> list[Result]:
            nonlocal fetches
            fetches += 1
            if fetches == 1:
                rollout.cable.lead_to(rollout.second.port)
                asyncio.get_running_loop().call_later(0.5, rollout.cable.lead_to, rollout.first.port)
            return await fetch(after)

        stream._missed = missed
        async with stream:
            await stream.send(clip.frames[1])
            first = await anext(stream)
            # As if the connection had broken before the answer came.
            stream._last_seq, stream._sender._unanswered[1] = 0, (None, Frame(clip.frames[1], seq=1))
            rollout.cable.cut()
            again = await anext(stream)
            assert (again.seq, again.target) == (first.seq, first.target)
            assert fetches == 2


async def test_a_session_that_has_ended_is_not_waited_for(own_server: Serve, clip: Clip, tmp_path: Path) -> None:
    server = own_server(state_dir=tmp_path / "state")
    async with AsyncClient(server.url) as client, AsyncClient(server.url) as other:
        session = await client.create(clip.frames[0], clip.box)
        stream = session.stream(paced(clip, 20), mode="lossless", reconnect_for_s=600)
        await anext(stream)
        await (await other.session(session.id)).close()
        with pytest.raises(Problem) as gone:
            await drained(stream)
        assert (gone.value.code, gone.value.status) == ("session-gone", 410)


async def test_a_session_that_stays_away_is_given_up(own_server: Serve, clip: Clip, tmp_path: Path) -> None:
    rollout = Rollout(own_server, tmp_path)
    async with rollout.cable, AsyncClient(rollout.cable.url, timeout_s=10) as client:
        session = await client.create(clip.frames[0], clip.box)
        stream = session.stream(paced(clip, 20), mode="lossless", reconnect_for_s=0.5)
        await anext(stream)
        rollout.cable.lead_to(rollout.second.port)
        with pytest.raises(Problem) as gone:
            await drained(stream)
        assert gone.value.code == "session-not-found"
