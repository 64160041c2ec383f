"""Flow: what waits, what is dropped, who is attached, and clients that behave like networks do."""

from __future__ import annotations

import asyncio
import socket
import struct
import time
from typing import Any

import msgpack
import pytest
from websockets.exceptions import InvalidStatus

from service.client import AsyncClient, Problem, Result
from service.load.clips import Clip
from service.load.own import OwnServer
from service.load.usage import server_processes, usage

from .conftest import Serve, watch
from .raw import MSGPACK, Raw, attach
from .test_main_job import assert_same, in_process

PING = {"ping_interval_s": 0.4, "ping_timeout_s": 0.4}


async def results_of(raw: Raw, last: int) -> list[Result]:
    """All messages up to the result of frame ``last``."""
    results = []
    while not results or results[-1].seq < last:
        said = await raw.receive()
        assert said["type"] == "result", said
        results.append(Result.of(said))
    return results


async def test_latest_keeps_the_newest(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """Whatever is sent at once, the first and the last are tracked, and every other is counted."""
    async with (
        await client.create(clip.frames[0], clip.box) as session,
        attach(server, session.id, mode="latest") as raw,
    ):
        for burst in range(5):
            last = (burst + 1) * 40
            for index in range(40):
                await raw.frame(clip.frames[1 + index], ts=index)
            results = await results_of(raw, last)
            assert results[-1].ts == 39
            assert len(results) + sum(r.dropped for r in results) == 40
            assert sum(r.dropped for r in results) > 0
        past = await session.trajectory()
        assert len(past) == 1 + len({r.seq for r in past} - {0})


async def test_latest_tracks_what_it_says(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """The boxes are those of the library on the very frames that were not dropped."""
    from mfcmt_core import MFCMT
    from service.frames.decode import decode
    from service.load.clips import LIMITS

    async with await client.create(clip.frames[0], clip.box) as session:
        async with attach(server, session.id, mode="latest") as raw:
            for frame in clip.frames[1:]:
                await raw.frame(frame)
            results = await results_of(raw, len(clip.frames) - 1)
        tracker = MFCMT()
        tracker.init(decode(clip.frames[0], LIMITS)[0], clip.box)
        for result in results:
            assert_same(result.target, tracker.update(decode(clip.frames[result.seq], LIMITS)[0]))


async def test_a_bad_frame_does_not_replace_a_good_one(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """What fails the checks of size and type is refused at once; what waits goes on waiting."""
    async with (
        await client.create(clip.frames[0], clip.box) as session,
        attach(server, session.id, mode="latest") as raw,
    ):
        for _ in range(5):
            await raw.frame(clip.frames[1])
            await raw.frame(clip.frames[2], ts="last")
            await raw.frame(b"no image")
            said, refused = [], 0
            while not (refused and said and said[-1]["ts"] == "last"):
                message = await raw.receive()
                if message["type"] == "error":
                    assert message["problem"]["code"] == "unsupported-image"
                    refused += 1
                else:
                    said.append(message)


async def test_lossless_credit(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """One frame above the credit is refused and not queued; all others are answered, in order."""
    async with await client.create(clip.frames[0], clip.box) as session, attach(server, session.id) as raw:
        sent = 40
        for index in range(sent):
            await raw.frame(clip.frames[1 + index % 50])
        answered, refused = [], []
        while len(answered) + len(refused) < sent:
            said = await raw.receive()
            if said["type"] == "result":
                answered.append(said["seq"])
            else:
                assert said["problem"]["code"] == "over-credit"
                assert said["problem"]["status"] == 429
                assert said["problem"]["retry_after_s"] > 0
                refused.append(said["seq"])
        assert answered == sorted(answered)
        assert sorted(answered + refused) == list(range(1, sent + 1))
        assert answered[:4] == [1, 2, 3, 4]
        assert refused


async def test_pings_are_answered_under_load(serve: Serve, clip: Clip) -> None:
    """Short pings, three times as many frames as can be tracked, for many ping intervals."""
    server = serve(**PING)
    with watch(server):
        async with (
            AsyncClient(server.url) as client,
            await client.create(clip.frames[0], clip.box) as session,
            attach(server, session.id, mode="latest") as raw,
        ):
            end = time.monotonic() + 4
            results = 0

            async def read() -> None:
                nonlocal results
                async for _ in raw.socket:
                    results += 1

            reading = asyncio.create_task(read())
            index = 0
            while time.monotonic() < end:
                index += 1
                await raw.frame(clip.frames[index % 60])
                if index % 20 == 0:
                    await asyncio.wait_for(await raw.socket.ping(), 2)
                    await asyncio.sleep(0)
            assert not reading.done()
            assert results > 50
            reading.cancel()


async def test_a_slow_lane_does_not_end_the_stream(serve: Serve, clip: Clip) -> None:
    """A lossless client whose credit is used up sends nothing for long; the connection stands."""
    server = serve(**PING, credit_frames=1)
    async with (
        AsyncClient(server.url) as client,
        await client.create(clip.frames[0], clip.box) as session,
        attach(server, session.id) as raw,
    ):
        await asyncio.sleep(2)
        await raw.frame(clip.frames[1])
        assert (await raw.receive())["seq"] == 1


async def test_one_attachment_at_a_time(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    async with await client.create(clip.frames[0], clip.box) as session:
        async with attach(server, session.id) as first:
            assert (await session.refresh()).attached
            with pytest.raises(InvalidStatus) as denied:
                async with attach(server, session.id):
                    pass
            assert denied.value.response.status_code == 409
            with pytest.raises(Problem) as refused:
                await session.track(clip.frames[1])
            assert refused.value.code == "attached-elsewhere"
            async with attach(server, session.id, takeover="true") as second:
                assert await first.closed() == 4409
                await second.frame(clip.frames[1])
                assert_same(Result.of(await second.receive()).target, in_process(clip, [clip.box])[0][0])
        assert not (await session.refresh()).attached
        await session.track(clip.frames[2])


async def test_takeover_keeps_what_is_in_work(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """``ready`` tells what was reached; what was missed is in the trajectory; nothing is tracked twice."""
    async with await client.create(clip.frames[0], clip.box) as session:
        said = in_process(clip, [clip.box])
        reached = 0
        for _ in range(10):
            async with attach(server, session.id, takeover="true", ready=False) as raw:
                ready = await raw.receive()
                reached = ready["session"]["seq"]
                assert ready["next_seq"] > reached
                for index in range(3):
                    await raw.frame(clip.frames[reached + 1 + index], seq=reached + 1 + index)
        async with attach(server, session.id, takeover="true"):
            past = await session.trajectory(after=0)
        assert [r.seq for r in past] == list(range(1, len(past) + 1))
        assert [r.target.box for r in past] == [one[0].box for one in said[: len(past)]]
        assert len(past) >= reached


async def test_changes_over_http_are_told_to_the_stream(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    async with await client.create(clip.frames[0], clip.box) as session, attach(server, session.id) as raw:
        added = await session.add_target(clip.box)
        told = await raw.receive()
        assert told["type"] == "targets"
        assert "ref" not in told or told["ref"] is None
        assert [t["id"] for t in told["targets"]] == [0, 1]
        assert told["region"] == list(added.region or ())
        await session.correct_target(1, clip.box)
        assert (await raw.receive())["targets"][1]["scale"] == 1
        await session.remove_target(1)
        assert [t["id"] for t in (await raw.receive())["targets"]] == [0]
        await session.close()
        assert await raw.closed() == 1000


def _handshake(server: OwnServer, session_id: str) -> socket.socket:
    """A WebSocket after its handshake, as a bare socket."""
    plain = socket.create_connection(("127.0.0.1", server.port))
    plain.settimeout(20)
    plain.sendall(
        f"GET /v1/sessions/{session_id}/stream?mode=lossless HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\n"
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
async def test_a_client_that_vanishes(
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
            seq = (await session.refresh()).seq
            assert seq == 0 if part < 1 else seq in (0, 1)
            result = await session.track(clip.frames[seq + 1])
            assert_same(result.target, in_process(clip, [clip.box])[seq][0])


async def test_a_client_that_never_reads(serve: Serve, clip: Clip) -> None:
    """It is cut off, the front's memory stays, its neighbour notices nothing and the session lives on."""
    server = serve(send_timeout_s=1.0, max_messages_per_s=100_000)
    with watch(server) as log:
        async with AsyncClient(server.url) as client:
            deaf = await client.create(clip.frames[0], clip.box)
            neighbour = await client.create(clip.frames[0], clip.box)
            before = usage(server.pid).rss_bytes
            plain = await asyncio.to_thread(_handshake, server, deaf.id)
            plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            flood = asyncio.create_task(asyncio.to_thread(_flood, plain))
            async with attach(server, neighbour.id) as raw:
                for index in range(1, 40):
                    await raw.frame(clip.frames[index])
                    assert (await raw.receive())["seq"] == index
            await asyncio.wait_for(flood, 30)
            plain.close()
            give_up = time.monotonic() + 10
            while (await deaf.refresh()).attached:
                assert time.monotonic() < give_up
                await asyncio.sleep(0.05)
            assert usage(server.pid).rss_bytes - before < 30_000_000
            await deaf.track(clip.frames[1])
        assert len([r for r in log.lines(session=deaf.id) if r["event"] == "client does not read"]) == 1


def _flood(plain: socket.socket) -> None:
    """Send refused messages, whose answers are never read, until the server has had enough."""
    message = _binary(msgpack.packb({"type": "remove", "target": 9, "ref": "x" * 64}))
    end = time.monotonic() + 20
    try:
        while time.monotonic() < end:
            plain.sendall(message * 50)
    except OSError:
        return
    raise AssertionError("the server let it go on")


async def test_message_rate(serve: Serve, clip: Clip) -> None:
    """A burst is allowed, the rest refused with rate-limited, and who goes on is closed with 4429."""
    server = serve(max_messages_per_s=50, max_refused_messages=30)
    with watch(server):
        async with AsyncClient(server.url) as client:
            session = await client.create(clip.frames[0], clip.box)
            async with attach(server, session.id) as raw:
                for _ in range(60):
                    await raw.send({"type": "remove", "target": 9})
                codes = [(await raw.problem())["code"] for _ in range(60)]
                assert codes.count("target-not-found") >= 50
                assert set(codes) == {"target-not-found", "rate-limited"}
                await asyncio.sleep(0.5)
                await raw.frame(clip.frames[1])
                assert (await raw.receive())["type"] == "result"
                for _ in range(200):
                    await raw.send({"type": "remove", "target": 9})
                assert await raw.closed() == 4429
            assert (await session.refresh()).seq == 1


async def test_fair_between_neighbours(serve: Serve, clip: Clip) -> None:
    """Of two sessions in one lane one sends all it can; the other is answered within its own share."""
    server = serve()
    async with AsyncClient(server.url) as client:
        greedy = await client.create(clip.frames[0], clip.box)
        modest = await client.create(clip.frames[0], clip.box)
        async with attach(server, greedy.id) as flood, attach(server, modest.id) as raw:
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
                    await flood.receive()
                    answered += 1
                    credit += 1

            task = asyncio.create_task(flooding())
            between = []
            for index in range(1, 40):
                before = answered
                await raw.frame(clip.frames[index])
                assert (await raw.receive())["seq"] == index
                between.append(answered - before)
                await asyncio.sleep(0.01)
            done.set()
            await task
            # Never behind all four of the neighbour's: the one in work, the one in the socket, one turn.
            assert sorted(between)[len(between) // 2] <= 3


async def test_sessions_end_by_themselves(serve: Serve, clip: Clip) -> None:
    """Idle and absolute time; a tombstone with the reason; a stream is closed with its code."""
    server = serve(idle_timeout_s=1.0, attached_idle_timeout_s=2.0, max_session_s=30.0)
    with watch(server):
        async with AsyncClient(server.url) as client:
            quiet = await client.create(clip.frames[0], clip.box)
            watched = await client.create(clip.frames[0], clip.box)
            async with attach(server, watched.id) as raw:
                await asyncio.sleep(1.7)
                with pytest.raises(Problem) as gone:
                    await quiet.refresh()
                assert (gone.value.code, gone.value.status, gone.value.reason) == ("session-gone", 410, "idle")
                assert await raw.closed() == 4408
            with pytest.raises(Problem) as gone:
                await watched.track(clip.frames[1])
            assert gone.value.reason == "idle"
            await quiet.close()  # 204 while it is remembered
            with pytest.raises(InvalidStatus) as denied:
                async with attach(server, quiet.id):
                    pass
            assert denied.value.response.status_code == 410


async def test_absolute_time(serve: Serve, clip: Clip) -> None:
    server = serve(max_session_s=1.5)
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


async def test_admission_is_exact(serve: Serve, clip: Clip) -> None:
    """A hundred creations at once on ten free places: ten sessions, ninety 503 with Retry-After."""
    server = serve(lanes=2, max_sessions_per_lane=5)
    async with AsyncClient(server.url, timeout_s=60) as client:

        async def create() -> Problem | None:
            try:
                await client.create(clip.frames[0], clip.box)
            except Problem as refused:
                return refused
            return None

        answers = await asyncio.gather(*(create() for _ in range(100)))
        refused = [answer for answer in answers if answer is not None]
        assert len(refused) == 90
        assert {(r.code, r.status) for r in refused} == {("at-capacity", 503)}
        assert all(r.retry_after_s is not None and r.retry_after_s > 0 for r in refused)
        sessions = [s async for s in client.sessions()]
        assert len(sessions) == 10
        lanes = [pid for role, pid in server_processes(server.pid).items() if role.startswith("lane")]
        assert len(lanes) == 2
