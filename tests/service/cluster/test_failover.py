"""Nodes that are killed, stand still or drain, and a store that goes away: what clients see of it."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import pytest

from service.client import Problem
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.service.jsclient.conftest import Scenario

from .nodes import KEY, Run, client, create, kill, node
from .redis_server import RedisServer

HELD = 20


@pytest.fixture(scope="module")
def nodes(redis_server: RedisServer) -> Iterator[dict[str, OwnServer]]:
    """Two nodes; each test leaves both running."""
    with ExitStack() as stack:
        yield {name: stack.enter_context(node(name, redis_server, store_grace_s=0.5)) for name in ("c", "d")}


@contextmanager
def without(server: OwnServer) -> Iterator[None]:
    """Kill a node, and start it again at the end."""
    kill(server)
    try:
        yield
    finally:
        server.stop()
        server.start()


async def undisturbed(server: OwnServer, clip: Clip) -> list[tuple[float, ...]]:
    """Return the boxes of a session that nothing happens to."""
    async with client(server) as there, await there.create(clip.frames[0], clip.box) as session:
        return [r.target.box async for r in session.stream(clip.frames[1:], mode="lossless")]


async def test_a_session_outlives_its_killed_node(nodes: dict[str, OwnServer], clip: Clip) -> None:
    """No result is lost or doubled, and the client is told what was forgotten."""
    async with client(nodes["d"]) as there:
        session = await there.session(await create(nodes["c"], clip))
        run = Run(session, clip.frames[1:], HELD)
        await run.halfway.wait()
        with without(nodes["c"]):
            assert await run.finish() == list(range(len(clip.frames) - 1))
            assert len(run.resumed) == 1
            assert run.resumed[0].lost_after is not None
            assert run.resumed[0].lost_after <= HELD
            assert (await session.refresh()).stream.url.startswith(f"ws{nodes['d'].url[4:]}")
        await session.close()


async def test_the_javascript_client_outlives_a_killed_node(
    nodes: dict[str, OwnServer], clip: Clip, scenario: Scenario
) -> None:
    sid = await create(nodes["c"], clip)
    stream = {"mode": "lossless", "codec": "json", "fps": 25}
    task: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def heard(told: dict[str, int]) -> None:
        if told["seq"] == HELD:
            kill(nodes["c"])
            task.set_result(None)

    try:
        told = await scenario("attached", nodes["d"].url, heard, session=sid, key=KEY, stream=stream)
    finally:
        nodes["c"].stop()
        nodes["c"].start()
    assert task.done()
    assert len(told["seqs"]) == len(clip.frames) - 1
    assert told["seqs"] == sorted(set(told["seqs"]))  # what was not answered takes new numbers
    assert len(told["resumed"]) == 1
    assert told["url"].startswith(f"ws{nodes['d'].url[4:]}")


async def test_a_node_that_stood_still_lets_go_of_what_others_took_up(nodes: dict[str, OwnServer], clip: Clip) -> None:
    sid = await create(nodes["c"], clip)
    kill(nodes["c"], signal.SIGSTOP)
    try:
        async with client(nodes["d"]) as there:
            while True:
                try:
                    session = await asyncio.wait_for(there.session(sid), 1)
                except (TimeoutError, Problem):
                    continue
                break
            assert session.info.stream.url.startswith(f"ws{nodes['d'].url[4:]}")
            assert (await session.track(clip.frames[1])).seq == 1
            kill(nodes["c"], signal.SIGCONT)
            async with client(nodes["c"]) as back:
                again = await back.session(sid)
                assert (again.info.seq, again.info.stream.url) == (1, session.info.stream.url)
                assert (await again.track(clip.frames[2])).seq == 2
            await session.close()
    finally:
        kill(nodes["c"], signal.SIGCONT)


async def test_a_node_that_drains_hands_its_streams_over(nodes: dict[str, OwnServer], clip: Clip) -> None:
    """Nothing is forgotten: the boxes are those of a session that nothing happened to."""
    wanted = await undisturbed(nodes["d"], clip)
    async with client(nodes["c"]) as there:  # the client knows no other node
        session = await there.session(await create(nodes["c"], clip))
        idle = await create(nodes["c"], clip)
        run = Run(session, clip.frames[1:], HELD)
        await run.halfway.wait()
        kill(nodes["c"], signal.SIGTERM)
        try:
            assert await run.finish() == list(range(len(clip.frames) - 1))
            assert [resumed.lost_after for resumed in run.resumed] == [None]
            assert [result.target.box for result in run.results] == wanted
        finally:
            nodes["c"].stop()
        assert nodes["c"].exit_code == 0
        async with client(nodes["d"]) as other:
            assert (await (await other.session(idle)).track(clip.frames[1])).seq == 1
            for sid in (session.id, idle):
                await other.call("DELETE", f"/v1/sessions/{sid}")
        nodes["c"].start()


async def until(done: Callable[[], bool]) -> None:
    while not done():
        await asyncio.sleep(0.05)


async def test_streams_go_on_without_the_store(
    nodes: dict[str, OwnServer], clip: Clip, redis_server: RedisServer
) -> None:
    """New sessions are refused after the grace; a store that comes back empty is filled again."""
    wanted = await undisturbed(nodes["d"], clip)
    async with client(nodes["c"]) as there, client(nodes["d"]) as other:
        session = await there.create(clip.frames[0], clip.box)
        run = Run(session, clip.frames[1:], HELD)
        await run.halfway.wait()
        redis_server.kill()
        await until(lambda: "the store is away" in nodes["c"].log)
        refused = None
        while refused is None:
            try:
                await (await there.create(clip.frames[0], clip.box, wait_s=0)).close()
            except Problem as problem:
                refused = problem
        assert (refused.code, refused.status) == ("at-capacity", 503)
        assert "store has been away" in refused.detail
        with pytest.raises(Problem) as unknown:
            await other.session(session.id)
        assert unknown.value.code == "at-capacity"  # and not session-not-found, which would be final
        assert await run.finish() == list(range(len(clip.frames) - 1))
        assert run.resumed == []
        assert [result.target.box for result in run.results] == wanted
        redis_server.start()
        while True:
            try:
                found = await other.session(session.id)
            except Problem:
                await asyncio.sleep(0.05)
            else:
                break
        assert found.info.seq == len(clip.frames) - 1
        with without(nodes["c"]):
            while True:
                try:
                    taken = await other.session(session.id)
                except Problem:
                    continue
                if taken.info.stream.url.startswith(f"ws{nodes['d'].url[4:]}"):
                    break
            assert len(await taken.trajectory()) >= HELD
        await taken.close()
