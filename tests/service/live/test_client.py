"""The Python client through cables that break."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mfcmt_core.images.decode import decode
from service.client import (
    AsyncClient,
    AsyncStream,
    Client,
    ClientError,
    ConnectionLost,
    Frame,
    Problem,
    Region,
    Result,
)
from service.load.clips import LIMITS, Clip, encode
from service.load.own import OwnServer

from .cable import Cable
from .conftest import Serve, watch
from .test_main_job import assert_same, in_process

# Notices a dead connection within half a second.
IMPATIENT = {"ping_interval_s": 0.25, "timeout_s": 5.0}


async def paced(clip: Clip, fps: float, start: int = 1) -> AsyncIterator[bytes]:
    for frame in clip.frames[start:]:
        yield frame
        await asyncio.sleep(1 / fps)


async def drained(stream: AsyncStream[Any]) -> list[Result]:
    return [result async for result in stream]


async def test_lossless_tracks_every_frame_once_through_cuts(server: OwnServer, clip: Clip) -> None:
    """Every frame is tracked exactly once and in order, whatever happens to the connection."""
    with watch(server):
        async with Cable(server.port) as cable, AsyncClient(cable.url) as client:
            session = await client.create(clip.frames[0], clip.box)

            async def cutter() -> None:
                for _ in range(6):
                    await asyncio.sleep(0.15)
                    cable.cut()

            cutting = asyncio.create_task(cutter())
            results = [r async for r in session.stream(paced(clip, 40), mode="lossless")]
            await cutting
            said = in_process(clip, [clip.box])
            assert len(results) == len(said)
            for result, one in zip(results, said, strict=True):
                assert_same(result.target, one[0])
            assert all(a.seq < b.seq for a, b in pairwise(results))
            assert cable.connections >= 5
            await session.close()


async def test_latest_goes_on_to_the_newest_frame_through_cuts(server: OwnServer, clip: Clip) -> None:
    async with Cable(server.port) as cable, AsyncClient(cable.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        results: list[Result] = []
        async for result in session.stream(paced(clip, 40)):
            results.append(result)
            if len(results) in (10, 20):
                cable.cut()
        assert len(results) > 40
        last = await session.refresh()
        assert results[-1].seq == last.seq
        assert results[-1].target.box == last.targets[0].box
        await session.close()


async def test_a_client_takes_over_its_own_dead_connection(server: OwnServer, clip: Clip) -> None:
    async with (
        Cable(server.port) as cable,
        AsyncClient(cable.url, **IMPATIENT) as client,
        await client.create(clip.frames[0], clip.box) as session,
    ):
        results = []
        async for result in session.stream(paced(clip, 30), mode="lossless"):
            results.append(result)
            if len(results) == 10:
                cable.go_dead()
        said = in_process(clip, [clip.box])
        assert [r.target.box for r in results] == [one[0].box for one in said]


async def test_an_attempt_that_was_not_heard_is_its_own_too(own_server: Serve, clip: Clip) -> None:
    """The server has attached a handshake whose answer was lost, and holds the session until it misses the pongs."""
    server = own_server(ping_interval_s=1, ping_timeout_s=1)
    async with (
        Cable(server.port) as cable,
        AsyncClient(cable.url, ping_interval_s=5, timeout_s=2) as client,
        await client.create(clip.frames[0], clip.box) as session,
    ):
        stream = session.stream(paced(clip, 30), mode="lossless")
        results = [await anext(stream)]
        rest = asyncio.create_task(drained(stream))
        cable.mute = True
        cable.cut()
        while server.log.count("stream attached") < 2:
            await asyncio.sleep(0.02)
        cable.go_dead()
        cable.mute = False
        results += await rest
        assert [r.seq for r in await session.trajectory(after=0)] == [r.seq for r in results]
        assert len(results) == len(clip.frames) - 1


async def test_a_client_does_not_take_over_the_connection_of_another(
    server: OwnServer, client: AsyncClient, clip: Clip
) -> None:
    """Whoever took the session over while our connection was dead keeps it."""
    async with (
        Cable(server.port) as cable,
        AsyncClient(cable.url, **IMPATIENT) as ours,
        await ours.create(clip.frames[0], clip.box) as session,
    ):
        stream = session.stream(paced(clip, 30), mode="lossless", reconnect_for_s=3)
        await anext(stream)
        cable.go_dead()
        other = (await client.session(session.id)).stream(mode="lossless", takeover=True)
        async with other:
            with pytest.raises(Problem) as refused:
                await drained(stream)
            assert refused.value.code == "attached-elsewhere"
            await other.send(clip.frames[1])
            assert (await anext(other)).target.status


async def test_a_stream_is_told_that_it_was_taken_over(client: AsyncClient, clip: Clip) -> None:
    async with await client.create(clip.frames[0], clip.box) as session:
        first = session.stream(mode="lossless")
        async with first, session.stream(mode="lossless", takeover=True) as second:
            with pytest.raises(Problem) as ended:
                await anext(first)
            assert (ended.value.code, ended.value.status) == ("attached-elsewhere", 409)
            with pytest.raises(StopAsyncIteration):
                await anext(first)
            await second.send(clip.frames[1])
            assert (await anext(second)).seq == 1


async def test_a_refused_frame_is_raised_and_the_stream_goes_on(client: AsyncClient, clip: Clip) -> None:
    frames = [clip.frames[1], clip.frames[2][:-200], b"no image", clip.frames[2]]
    async with await client.create(clip.frames[0], clip.box) as session:
        stream = session.stream(frames, mode="lossless")
        codes, results = [], []
        while True:
            try:
                results.append(await anext(stream))
            except Problem as refused:
                codes.append((refused.code, refused.seq))
            except StopAsyncIteration:
                break
        assert sorted(codes) == [("frame-undecodable", 2), ("unsupported-image", 3)]
        assert [r.seq for r in results] == [1, 4]
        taken: list[Problem] = []
        again = session.stream([b"no image", clip.frames[3]], mode="lossless", on_refused=taken.append)
        assert len([r async for r in again]) == 1
        assert [p.code for p in taken] == ["unsupported-image"]


async def test_refused_calls_raise_a_problem_with_its_code(client: AsyncClient, clip: Clip) -> None:
    with pytest.raises(Problem) as refused:
        await client.session("no-such-session")
    assert (refused.value.code, refused.value.status) == ("session-not-found", 404)
    with pytest.raises(Problem) as refused:
        await client.create(clip.frames[0], (5000, 5000, 10, 10))
    assert refused.value.code == "bad-box"
    with pytest.raises(Problem) as refused:
        await client.create(clip.frames[0], clip.box, no_such_option=1)
    assert refused.value.code == "bad-request"
    session = await client.create(clip.frames[0], clip.box)
    with pytest.raises(Problem) as refused:
        await session.correct_target(7, clip.box)
    assert refused.value.code == "target-not-found"
    stream = session.stream(mode="lossless")
    async with stream:
        await session.close()
        with pytest.raises(Problem) as refused:
            await anext(stream)
        assert (refused.value.code, refused.value.reason) == ("session-gone", "closed")
    with pytest.raises(Problem) as refused:
        await session.track(clip.frames[1])
    assert (refused.value.code, refused.value.reason) == ("session-gone", "closed")
    with pytest.raises(Problem) as refused:
        await anext(session.stream(mode="lossless"))
    assert refused.value.code == "session-gone"


async def test_controls_in_a_stream_change_its_targets(client: AsyncClient, clip: Clip) -> None:
    session = await client.create(clip.frames[0], clip.box)
    async with session, session.stream(mode="lossless") as stream:
        assert [t.id for t in (await stream.add(clip.box)).targets] == [0, 1]
        with pytest.raises(Problem) as refused:
            await stream.correct(9, clip.box)
        assert refused.value.code == "target-not-found"
        changed = asyncio.create_task(stream.correct(0, clip.box, on_next=True))
        await asyncio.sleep(0.05)
        assert not changed.done()
        await stream.send(clip.frames[1])
        result = await anext(stream)
        assert (await changed).targets[0].box == pytest.approx(clip.box)
        assert result.targets[0].reliable is None
        assert result.targets[1].reliable is not None
        assert [t.id for t in (await stream.remove(0)).targets] == [1]


async def test_frames_cut_by_a_function_of_ones_own_are_all_tracked(client: AsyncClient, clip: Clip) -> None:
    """Most frames are cuts, all are tracked, none is refused."""
    cuts: list[Region | None] = []

    def cut(image: np.ndarray, region: Region | None) -> bytes:
        cuts.append(region)
        if region is None:
            return encode(image)
        x, y, w, h = region
        return encode(np.ascontiguousarray(image[y : y + h, x : x + w]))

    images = [decode(frame, LIMITS)[0] for frame in clip.frames]
    async with await client.create(clip.frames[0], clip.box) as session:
        results = [r async for r in session.stream(images[1:], mode="lossless", encode=cut)]
        assert [r.seq for r in results] == list(range(1, len(images)))
        assert all(region is None or region[2] * region[3] > 0 for region in cuts)


async def test_a_reader_that_pauses_is_not_flooded(client: AsyncClient, clip: Clip) -> None:
    """While results wait unread no more frames are sent; nothing is lost in lossless mode."""
    async with await client.create(clip.frames[0], clip.box) as session:
        seqs = []
        async for result in session.stream(clip.frames[1:40], mode="lossless"):
            seqs.append(result.seq)
            if result.seq == 1:
                await asyncio.sleep(0.5)
        assert seqs == list(range(1, 40))


async def test_a_server_that_comes_back_without_the_session_ends_the_stream(own_server: Serve, clip: Clip) -> None:
    server = own_server(drain_grace_s=0.2)
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        stream = session.stream(paced(clip, 20), mode="lossless", reconnect_for_s=30)
        await anext(stream)
        await asyncio.to_thread(server.stop)
        await asyncio.to_thread(server.start)
        with pytest.raises(Problem) as gone:
            await drained(stream)
        assert gone.value.code == "session-not-found"


async def test_a_server_that_does_not_come_back_is_a_lost_connection(own_server: Serve, clip: Clip) -> None:
    server = own_server(drain_grace_s=0.2)
    async with AsyncClient(server.url, timeout_s=2) as client:
        session = await client.create(clip.frames[0], clip.box)
        stream = session.stream(paced(clip, 20), mode="lossless", reconnect_for_s=0.5)
        await anext(stream)
        await asyncio.to_thread(server.stop)
        with pytest.raises(ConnectionLost):
            await drained(stream)
        with pytest.raises(ConnectionLost):
            await session.refresh()


async def test_a_loop_that_is_left_ends_the_attachment(client: AsyncClient, clip: Clip) -> None:
    """By break, by an exception, with its iterator: the next call and the next stream need not wait or take over."""
    async with await client.create(clip.frames[0], clip.box) as session:
        async for _ in session.stream(clip.frames[1:], mode="lossless"):
            break
        assert (await session.track(clip.frames[20])).target.status
        named = session.stream(clip.frames[1:])
        with suppress(KeyError):
            async for _ in named:
                raise KeyError
        assert len([r async for r in session.stream(clip.frames[20:23], mode="lossless")]) == 3
        iterator = aiter(session.stream(clip.frames[1:], mode="lossless"))
        await anext(iterator)
        del iterator
        assert (await session.track(clip.frames[23])).target.status
        assert not (await session.refresh()).attached


async def test_a_loop_inside_a_block_may_be_left_and_entered_again(client: AsyncClient, clip: Clip) -> None:
    async with await client.create(clip.frames[0], clip.box) as session:
        seqs = []
        async with session.stream(clip.frames[1:10], mode="lossless") as stream:
            async for result in stream:
                seqs.append(result.seq)
                if len(seqs) == 3:
                    break
            assert (await session.refresh()).attached
            seqs += [result.seq async for result in stream]
        assert seqs == list(range(1, 10))
        assert (await session.track(clip.frames[10])).seq == 10


def test_a_loop_without_asyncio_that_is_left_ends_the_attachment(server: OwnServer, clip: Clip) -> None:
    with Client(server.url) as client, client.create(clip.frames[0], clip.box) as session:
        for index, _ in enumerate(session.stream(clip.frames[1:], mode="lossless")):
            if index == 3:
                break
        assert session.track(clip.frames[20]).target.status
        named = session.stream(clip.frames[1:])
        with suppress(KeyError):
            for _ in named:
                raise KeyError
        assert len(list(session.stream(clip.frames[20:23], mode="lossless"))) == 3
        next(session.stream(clip.frames[1:], mode="lossless"))  # the stream itself is dropped
        assert session.track(clip.frames[23]).target.status
        with session.stream(clip.frames[24:30], mode="lossless") as stream:
            for _ in stream:
                break
            assert session.refresh().attached
            assert len(list(stream)) == 5


def test_a_stream_that_is_never_closed_does_not_keep_the_program(server: OwnServer, clip: Clip, tmp_path: Path) -> None:
    """Neither a loop that is still open when the interpreter ends, nor one that outlives its client."""
    first, second = tmp_path / "0.jpg", tmp_path / "1.jpg"
    first.write_bytes(clip.frames[0])
    second.write_bytes(clip.frames[1])
    code = f"""
from pathlib import Path
from service.client import Client
frames = [Path({str(first)!r}), Path({str(second)!r})]
client = Client({server.url!r})
sessions = [client.create(frames[0], {tuple(clip.box)!r}) for _ in range(2)]
loops = [iter(session.stream(frames, mode="lossless")) for session in sessions]
print([next(loop).seq for loop in loops])
other = Client({server.url!r})
loop = iter(other.session(sessions[0].id).stream(frames, takeover=True))
next(loop)
other.close()
del loop
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[1, 1]\n", "")


async def test_creating_waits_for_a_place_as_long_as_it_is_told(own_server: Serve, clip: Clip) -> None:
    server = own_server(max_sessions_per_lane=1)
    async with AsyncClient(server.url) as client:
        first = await client.create(clip.frames[0], clip.box)
        for wait_s in (0, 0.3):
            with pytest.raises(Problem) as full:
                await client.create(clip.frames[0], clip.box, wait_s=wait_s)
            assert (full.value.code, full.value.status) == ("at-capacity", 503)
        waiting = asyncio.create_task(client.create(clip.frames[0], clip.box))
        while server.log.count("at-capacity") < 4:
            await asyncio.sleep(0.02)
        assert not waiting.done()
        snapshot = await first.snapshot()
        await first.close()
        second = await waiting
        restoring = asyncio.create_task(client.restore(snapshot))
        await second.close()
        assert (await restoring).info.seq == 0


async def test_wrong_sources_raise_an_error_that_says_why(client: AsyncClient, clip: Clip) -> None:
    async with await client.create(clip.frames[0], clip.box) as session:
        with pytest.raises(ClientError, match="bytes or a Path, not str"):
            await drained(session.stream(["text"], mode="lossless"))
        with pytest.raises(ClientError, match=r"cv2\.imencode"):
            await drained(session.stream([np.zeros((8, 8, 3), np.uint8)], mode="lossless"))

        def broken() -> Iterator[bytes]:
            yield clip.frames[1]
            raise OSError("no camera")

        with pytest.raises(ClientError, match="no camera"):
            await drained(session.stream(broken(), mode="lossless"))
        assert (await session.track(Frame(clip.frames[2]))).seq >= 1


def test_the_client_imports_neither_numpy_nor_opencv() -> None:
    code = "import sys, service.client; sys.exit(bool({'numpy', 'cv2', 'numba'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
