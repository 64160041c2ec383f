"""Flow: what waits, what is dropped, who is attached, and clients that behave like networks do."""

from __future__ import annotations

import asyncio
import socket
import struct
import time
from collections import Counter
from dataclasses import replace
from typing import Any

import msgpack
import pytest

from mfcmt_core import MFCMT
from mfcmt_core.images.decode import decode
from service.client import AsyncClient, Problem, Result
from service.client.types import read_answer
from service.load.clips import LIMITS, Clip
from service.load.own import OwnServer
from service.load.usage import usage
from tests.service.wire.conftest import Stream

from .conftest import MSGPACK, Serve, attach, watch
from .test_main_job import assert_same, in_process

PING = {"ping_interval_s": 0.4, "ping_timeout_s": 0.4}


async def results_of(stream: Stream, last: int) -> list[Result]:
    """All messages up to the result of frame ``last``."""
    results = []
    while not results or results[-1].seq < last:
        results.append(read_answer(Result, await stream.hear("result")))
    return results


async def test_latest_tracks_what_it_says(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """The boxes are those of the library on the very frames that were not dropped."""
    async with await client.create(clip.frames[0], clip.box) as session:
        async with attach(server, session.id, mode="latest") as stream:
            for frame in clip.frames[1:]:
                await stream.frame(frame)
            results = await results_of(stream, len(clip.frames) - 1)
        tracker = MFCMT()
        tracker.init(decode(clip.frames[0], LIMITS)[0], clip.box)
        for result in results:
            assert_same(result.target, tracker.update(decode(clip.frames[result.seq], LIMITS)[0]))


async def test_a_bad_frame_does_not_replace_a_good_one(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """What fails the checks of size and type is refused at once; what waits goes on waiting."""
    async with (
        await client.create(clip.frames[0], clip.box) as session,
        attach(server, session.id, mode="latest") as stream,
    ):
        for _ in range(5):
            await stream.frame(clip.frames[1])
            await stream.frame(clip.frames[2], ts="last")
            await stream.frame(b"no image")
            said, refused = [], 0
            while not (refused and said and said[-1]["ts"] == "last"):
                message = await stream.hear()
                if message["type"] == "error":
                    assert message["problem"]["code"] == "unsupported-image"
                    refused += 1
                else:
                    said.append(message)


async def test_pings_are_answered_under_load(own_server: Serve, clip: Clip) -> None:
    """Short pings, three times as many frames as can be tracked, for many ping intervals."""
    server = own_server(**PING)
    with watch(server):
        async with (
            AsyncClient(server.url) as client,
            await client.create(clip.frames[0], clip.box) as session,
            attach(server, session.id, mode="latest") as stream,
        ):
            end = time.monotonic() + 4
            results = 0

            async def read() -> None:
                nonlocal results
                async for _ in stream.socket:
                    results += 1

            reading = asyncio.create_task(read())
            index = 0
            while time.monotonic() < end:
                index += 1
                await stream.frame(clip.frames[index % 60])
                if index % 100 == 0:  # fewer than the control frames that a client may send in a second
                    await asyncio.wait_for(await stream.socket.ping(), 2)
                    await asyncio.sleep(0)
            assert not reading.done()
            assert results > 50
            reading.cancel()


async def test_a_slow_lane_does_not_end_the_stream(own_server: Serve, clip: Clip) -> None:
    """A lossless client whose credit is used up sends nothing for long; the connection stands."""
    server = own_server(**PING, credit_frames=1)
    async with (
        AsyncClient(server.url) as client,
        await client.create(clip.frames[0], clip.box) as session,
        attach(server, session.id) as stream,
    ):
        await asyncio.sleep(2)
        await stream.frame(clip.frames[1])
        assert (await stream.hear())["seq"] == 1


async def test_takeover_keeps_what_is_in_work(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """``ready`` tells what was reached; what was missed is in the trajectory; nothing is tracked twice."""
    async with await client.create(clip.frames[0], clip.box) as session:
        reached = 0
        for _ in range(10):
            async with attach(server, session.id, takeover="true") as stream:
                reached = stream.ready["session"]["seq"]
                first = stream.ready["next_seq"]  # what waited when the last stream ended was discarded
                assert first > reached
                for seq in range(first, first + 3):
                    await stream.frame(clip.frames[seq], seq=seq)
        async with attach(server, session.id, takeover="true"):
            past = await session.trajectory(after=0)
        tracked = [r.seq for r in past]
        assert tracked == sorted(set(tracked))
        assert reached in (0, *tracked)
        said = in_process(replace(clip, frames=[clip.frames[seq] for seq in (0, *tracked)]), [clip.box])
        assert [r.target.box for r in past] == [one[0].box for one in said]


def _handshake(server: OwnServer, session_id: str) -> socket.socket:
    """A WebSocket after its handshake, as a bare socket that buffers little of what it does not read."""
    plain = socket.socket()
    # Set before connecting: a window that shrinks later has the kernel drop what carries acknowledgements, too.
    plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    plain.settimeout(20)
    plain.connect(("127.0.0.1", server.port))
    plain.sendall(
        f"GET /v1/sessions/{session_id}/stream?mode=lossless HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\n"
        f"Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        f"Sec-WebSocket-Protocol: {MSGPACK}\r\n\r\n".encode()
    )
    head = b""
    while b"\r\n\r\n" not in head:
        head += plain.recv(1)
    assert b" 101 " in head
    return plain


def _binary(payload: bytes) -> bytes:
    """A masked WebSocket message (the mask is zero)."""
    return b"\x82\xff" + struct.pack(">Q", len(payload)) + bytes(4) + payload


@pytest.mark.parametrize("abrupt", [True, False])
@pytest.mark.parametrize("part", [0.3, 1.0])
async def test_a_session_lives_on_when_its_client_vanishes(
    server: OwnServer, client: AsyncClient, clip: Clip, abrupt: bool, part: float
) -> None:
    """In the middle of a message, or with a frame in work: the session lives on, with what was whole."""
    async with await client.create(clip.frames[0], clip.box) as session:
        with watch(server):
            plain = await asyncio.to_thread(_handshake, server, session.id)
            message = _binary(msgpack.packb({"type": "frame", "frame": clip.frames[1]}))
            plain.sendall(message[: int(len(message) * part)])
            await asyncio.sleep(0.1 if part < 1 else 0)
            if abrupt:  # a reset instead of an orderly end
                plain.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            plain.close()
            give_up = time.monotonic() + 10
            while (await session.refresh()).attached:
                assert time.monotonic() < give_up
                await asyncio.sleep(0.02)
            await session.snapshot()  # comes behind a frame that is still in work
            seq = (await session.refresh()).seq
            assert seq == 0 if part < 1 else seq in (0, 1)
            result = await session.track(clip.frames[seq + 1])
            assert_same(result.target, in_process(clip, [clip.box])[seq][0])


async def test_a_client_that_never_reads_is_cut_off_alone(own_server: Serve, clip: Clip) -> None:
    """It is cut off, the front's memory stays, its neighbour notices nothing and the session lives on."""
    server = own_server(send_timeout_s=1.0, max_messages_per_s=100_000, max_refusals_per_s=100_000)
    with watch(server) as log:
        async with AsyncClient(server.url) as client:
            deaf = await client.create(clip.frames[0], clip.box)
            neighbour = await client.create(clip.frames[0], clip.box)
            before = usage(server.pid).rss_bytes
            plain = await asyncio.to_thread(_handshake, server, deaf.id)
            flood = asyncio.create_task(asyncio.to_thread(_flood, plain))
            async with attach(server, neighbour.id) as stream:
                for index in range(1, 40):
                    await stream.frame(clip.frames[index])
                    assert (await stream.hear())["seq"] == index
            await asyncio.wait_for(flood, 60)
            give_up = time.monotonic() + 20
            while (await deaf.refresh()).attached:  # by the server: this end stays open
                assert time.monotonic() < give_up
                await asyncio.sleep(0.05)
            plain.close()
            assert usage(server.pid).rss_bytes - before < 30_000_000
            await deaf.track(clip.frames[1])
        events = [record["event"] for record in log.lines(session=deaf.id)]
        assert events.count("client does not read") == 1, Counter(events)


def _flood(plain: socket.socket) -> None:
    """Send refused messages, whose answers are never read, until no more are taken."""
    message = _binary(msgpack.packb({"type": "remove", "target": 9, "ref": "x" * 64}))
    end = time.monotonic() + 20
    try:
        while time.monotonic() < end:
            plain.sendall(message * 50)
    except OSError:
        return
    raise AssertionError("the server let it go on")


async def test_a_greedy_session_leaves_its_neighbour_its_share(own_server: Serve, clip: Clip) -> None:
    """Of two sessions in one lane one sends all it can; the other is answered within its own share."""
    server = own_server()
    async with AsyncClient(server.url) as client:
        greedy = await client.create(clip.frames[0], clip.box)
        modest = await client.create(clip.frames[0], clip.box)
        async with attach(server, greedy.id) as flood, attach(server, modest.id) as stream:
            done = asyncio.Event()
            answered = 0

            async def flooding() -> None:
                nonlocal answered
                credit = 4
                index = 0
                while not done.is_set():
                    while credit:
                        index += 1
                        await flood.frame(clip.frames[index % 60])
                        credit -= 1
                    await flood.hear()
                    answered += 1
                    credit += 1

            task = asyncio.create_task(flooding())
            between = []
            for index in range(1, 40):
                before = answered
                await stream.frame(clip.frames[index])
                assert (await stream.hear())["seq"] == index
                between.append(answered - before)
                await asyncio.sleep(0.01)
            done.set()
            await task
            # Never behind all four of the neighbour's: the one in work, the one in the socket, one turn.
            assert sorted(between)[len(between) // 2] <= 3


async def test_a_session_ends_after_its_absolute_time(own_server: Serve, clip: Clip) -> None:
    server = own_server(max_session_s=1.5)
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        reason: Any = None
        for _ in range(60):
            try:
                await session.track(clip.frames[1])
            except Problem as gone:
                reason = gone.reason
                break
            await asyncio.sleep(0.05)
        assert reason == "expired"
