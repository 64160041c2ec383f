"""Floods on bare sockets: who sends too much of what carries nothing is cut, and what is under way has a bound."""

from __future__ import annotations

import asyncio
import json
import re
import socket
from collections.abc import AsyncIterator, Iterator

import httpx2
import psutil
import pytest

from service.load.clips import Clip
from service.load.own import OwnServer
from service.load.usage import server_processes
from tests.tools.siege.traffic import BINARY, MIB, PING, TEXT, UNFINISHED, frame, padded

from .conftest import Serve, Wire, reset, under_way_bytes

PATIENCE_S = 30.0
PONG = b"\x8a\x00"
KEY = "the-key-of-these-tests"
Pair = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@pytest.fixture(scope="module")
def keyed() -> Iterator[OwnServer]:
    with OwnServer(lanes=1, max_sessions_per_lane=64, api_keys=KEY, max_refusals_per_s=50) as own:
        yield own


@pytest.fixture
async def wire(keyed: OwnServer) -> AsyncIterator[Wire]:
    async with Wire(keyed, {"X-API-Key": KEY}) as opened:
        yield opened
    assert "Traceback" not in keyed.log


async def call(wire: Wire, path: str, *, method: str = "GET", headers: str = "", body: bytes = b"") -> Pair:
    """A call on a connection of its own, with the key, whose kernel holds little that is not read."""
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
    sock.setblocking(False)
    await asyncio.get_running_loop().sock_connect(sock, ("127.0.0.1", wire.server.port))
    reader, writer = await asyncio.open_connection(sock=sock, limit=1 << 14)
    keys = "".join(f"{name}: {value}\r\n" for name, value in wire.headers.items())
    writer.write(f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n{keys}{headers}\r\n".encode() + body)
    return reader, writer


async def attach(wire: Wire, sid: str, headers: str = "", query: str = "") -> tuple[Pair, bytes]:
    """A handshake without a library behind it, and the head of its answer."""
    more = (
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n{headers}"
    )
    pair = await call(wire, f"/v1/sessions/{sid}/stream?takeover=true{query}", headers=more)
    return pair, await asyncio.wait_for(pair[0].readuntil(b"\r\n\r\n"), PATIENCE_S)


async def rest(pair: Pair) -> bytes:
    """All that comes until the connection ends."""
    received = b""
    try:
        async with asyncio.timeout(PATIENCE_S):
            while data := await pair[0].read(1 << 16):
                received += data
    except ConnectionError:
        pass
    pair[1].close()
    return received


def closed_with(received: bytes) -> int | None:
    """The code of the close frame at the end."""
    found = re.search(rb"\x88[\x02-\x7d](..)[^\x00-\x1f]*\Z", received, re.S)
    return int.from_bytes(found[1], "big") if found else None


async def session(wire: Wire, clip: Clip) -> str:
    sid: str = (await wire.create(clip.frames[0], clip.box))["id"]
    return sid


async def test_a_refused_handshake_is_left_at_once(wire: Wire) -> None:
    """Its close frame is the last word: pings behind it are not even read."""
    pair, head = await attach(Wire(wire.server), "any", "Origin: http://elsewhere.example\r\n")
    assert b" 101 " in head
    received = b""
    while b"\x88" not in received:
        received += await asyncio.wait_for(pair[0].read(1000), PATIENCE_S)
    assert b"origin-refused" in received
    pair[1].write(frame(PING, b"") * 100)
    assert PONG not in received + await rest(pair)


async def test_too_many_pings_cut_a_stream_and_some_do_not(wire: Wire, clip: Clip) -> None:
    sid = await session(wire, clip)
    pair, _ = await attach(wire, sid)
    pair[1].write(frame(PING, b"") * 60)
    received = b""
    while received.count(PONG) < 60:
        received += await asyncio.wait_for(pair[0].read(1 << 16), PATIENCE_S)
    pair[1].write(frame(PING, b"") * 20_000)
    assert (await rest(pair)).count(PONG) < 2000


@pytest.mark.parametrize("size", [0, 100])
async def test_a_message_in_crumbs_cuts_its_stream(wire: Wire, clip: Clip, size: int) -> None:
    pair, _ = await attach(wire, await session(wire, clip))
    crumb = frame(0, bytes(size), fin=False)
    pair[1].write(frame(BINARY, b"", fin=False) + crumb * 5000)
    await rest(pair)


async def test_a_message_in_honest_parts_is_read(wire: Wire, clip: Clip) -> None:
    """As some clients send every message: in parts of 4 kB, or of 1 kB."""
    async with wire.stream(await session(wire, clip)) as stream:
        for size in (4096, 1024):
            for n in range(1, 10):
                data = clip.frames[n]
                await stream.socket.send([data[at : at + size] for at in range(0, len(data), size)])
                await stream.hear("result")


async def test_messages_that_are_no_use_end_all_streams_of_their_key(wire: Wire, clip: Clip) -> None:
    """Coming back does not help."""
    sid, other = await session(wire, clip), await session(wire, clip)
    pair, _ = await attach(wire, sid)
    pair[1].write(frame(TEXT, b'{"type":"x"}') * 3000)
    received = await rest(pair)
    assert closed_with(received) == 4429
    assert received.count(b"bad-request") < 1000
    pair, _ = await attach(wire, other)
    pair[1].write(frame(TEXT, b'{"type":"x"}') * 200)
    received = await rest(pair)
    assert closed_with(received) == 4429


async def test_text_that_is_not_utf_8_closes_the_stream_and_is_no_fault(wire: Wire, clip: Clip) -> None:
    pair, _ = await attach(wire, await session(wire, clip))
    pair[1].write(frame(TEXT, b"\xff\xfe"))
    assert closed_with(await rest(pair)) == 1007


async def test_calls_in_one_packet_are_all_answered_in_order(wire: Wire) -> None:
    pair = await call(wire, "/livez")
    for n in range(600):
        pair[1].write(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Request-ID: n%d\r\n\r\n" % n)
        body = b"x" * n
        pair[1].write(b"POST /nothing HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n%s" % (n, body))
    pair[1].write(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    received = await rest(pair)
    assert [int(n) for n in re.findall(rb"x-request-id: n(\d+)\r", received)] == list(range(600))
    assert received.count(b"HTTP/1.1 404") == 600
    assert received.count(b"HTTP/1.1 200") == 602


@pytest.mark.parametrize(
    "head",
    [
        "a:\r\n" * 200,
        f"X-A: {'a' * 9000}\r\n",
        f"Connection: {'a,' * 1500}\r\n",
        f"Content-Type: multipart/form-data; x={';' * 9000}\r\n",
    ],
    ids=["many", "long", "list", "media type"],
)
async def test_heads_that_take_long_to_read_are_refused(wire: Wire, head: str) -> None:
    for more in ("", "Upgrade: websocket\r\nConnection: Upgrade\r\n"):
        assert (await rest(await call(wire, "/v1/sessions", headers=more + head))).startswith(b"HTTP/1.1 400")
    assert (await rest(await call(wire, "/?" + "a&" * 5000))).startswith(b"HTTP/1.1 400")


async def test_a_call_without_a_key_is_refused_before_its_path_is_looked_for(wire: Wire) -> None:
    bare = Wire(wire.server)
    for path in ("/v1/sessions", "/v1/nothing"):
        response = await bare.http.get(path)
        assert (response.status_code, response.json()["code"]) == (401, "unauthenticated")
    assert (await wire.http.get("/v1/nothing")).status_code == 404


async def test_answers_that_nobody_reads_have_a_bound(serve: Serve, clip: Clip) -> None:
    """What does not fit is refused; who reads gets all of it again once the others are gone."""
    wire = serve(max_upload_bytes=40 * MIB)
    sid = (await wire.create(padded(clip.frames[0], 8 * MIB), clip.box))["id"]
    deaf: list[Pair] = []
    codes: list[bytes] = []
    for _ in range(12):
        pair = await call(wire, f"/v1/sessions/{sid}/snapshot")
        codes.append((await asyncio.wait_for(pair[0].read(12), PATIENCE_S))[9:])
        deaf.append(pair)
    assert codes[0] == b"200"
    assert b"503" in codes
    for _, writer in deaf:
        reset(writer)
    async with asyncio.timeout(PATIENCE_S):
        while (response := await wire.http.get(f"/v1/sessions/{sid}/snapshot")).status_code != 200:
            assert response.json()["code"] == "at-capacity"
            await asyncio.sleep(0.05)


async def test_messages_that_are_not_finished_have_a_bound_together(serve: Serve, clip: Clip) -> None:
    wire = serve(max_upload_bytes=24 * MIB)
    streams = [(await attach(wire, await session(wire, clip)))[0] for _ in range(4)]
    for _, writer in streams:
        writer.write(UNFINISHED + bytes(6 * MIB))
    ends = [asyncio.ensure_future(rest(pair)) for pair in streams]
    done, waiting = await asyncio.wait(ends, timeout=PATIENCE_S, return_when=asyncio.FIRST_COMPLETED)
    assert done
    for end in waiting:
        end.cancel()
    assert (await wire.http.get("/livez")).status_code == 200
    assert "too many bytes under way" in wire.server.log
    for _, writer in streams:
        reset(writer)
    async with asyncio.timeout(PATIENCE_S):
        while await under_way_bytes(wire):
            await asyncio.sleep(0.05)
    assert (await wire.post(clip.frames[0] + bytes(7 * MIB), clip.box)).status_code == 201


@pytest.mark.parametrize(("room", "announced", "code"), [(24, 13, 1013), (256, 17, 1009)], ids=["room", "size"])
async def test_who_sends_a_message_for_which_there_is_no_room_is_told_so(
    serve: Serve, clip: Clip, room: int, announced: int, code: int
) -> None:
    """The close frame comes although the client reads it only after its whole message."""
    wire = serve(max_upload_bytes=room * MIB)
    sid = await session(wire, clip)
    for _ in range(5):
        pair, _ = await attach(wire, sid)
        async with asyncio.timeout(PATIENCE_S):
            pair[1].write(frame(BINARY, bytes(announced * MIB)))
            await pair[1].drain()
            assert closed_with(await rest(pair)) == code


async def test_a_repeated_creation_does_not_keep_its_frame_while_it_waits(serve: Serve, clip: Clip) -> None:
    """Ten times three megabytes wait where twelve may be under way."""
    wire = serve(max_upload_bytes=24 * MIB, operation_deadline_s=120, body_timeout_s=60)
    await session(wire, clip)
    lane = psutil.Process(server_processes(wire.server.pid)["lane 0"])
    heavy, key = padded(clip.frames[0], 3 * MIB), {"Idempotency-Key": "once"}

    def post() -> asyncio.Task[httpx2.Response]:
        return asyncio.create_task(wire.post(heavy, clip.box, headers=key))

    lane.suspend()
    try:
        posts = [post()]
        await asyncio.sleep(1)
        for _ in range(10):
            posts.append(post())
            await asyncio.sleep(0.2)
        # A busy machine receives several at once, and refuses some; those are let in when they come again.
        async with asyncio.timeout(PATIENCE_S):
            await asyncio.sleep(1)
            while refused := [number for number, one in enumerate(posts) if one.done()]:
                for number in refused:
                    assert posts[number].result().status_code == 503
                    posts[number] = post()
                    await asyncio.sleep(0.2)
                await asyncio.sleep(1)
    finally:
        lane.resume()
    answers = await asyncio.gather(*posts)
    assert [answer.status_code for answer in answers] == [201] * 11, [answer.text for answer in answers]
    assert len({answer.json()["id"] for answer in answers}) == 1


async def test_json_of_many_items_is_refused_unread(wire: Wire) -> None:
    response = await wire.http.post("/v1/sessions", json={"frame": "", "boxes": [[1, 1, 1, 1]] * 1000})
    assert (response.status_code, response.json()["detail"]) == (400, "too many items")
    assert json.loads(response.text)["code"] == "bad-request"
