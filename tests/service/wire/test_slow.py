"""Silent, slow and crowded connections on bare sockets: each has its time, and the others do not notice."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import httpx2
import psutil
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from service.load.clips import Clip
from service.load.own import OwnServer
from tests.tools.siege.traffic import MIB

from .conftest import Serve, Wire, reset, under_way_bytes

HOST = b"Host: localhost\r\n"
# Ample on a busy machine, and far below what an unbounded wait would be.
PATIENCE_S = 30.0
Pair = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@pytest.fixture(scope="module")
def short_times() -> Iterator[OwnServer]:
    """A server that waits half a second for anything."""
    with OwnServer(lanes=1, head_timeout_s=0.5, body_timeout_s=0.5) as own:
        yield own


@pytest.fixture
async def wire(short_times: OwnServer) -> AsyncIterator[Wire]:
    async with Wire(short_times) as opened:
        yield opened
    assert "Traceback" not in short_times.log


async def dial(wire: Wire, sent: bytes = b"") -> Pair:
    reader, writer = await asyncio.open_connection("127.0.0.1", wire.server.port)
    writer.write(sent)
    return reader, writer


async def ended(pair: Pair) -> bytes:
    """All that comes until the server ends the connection."""
    reader, writer = pair
    received = b""
    try:
        async with asyncio.timeout(PATIENCE_S):
            while data := await reader.read(65536):
                received += data
    except ConnectionError:
        pass
    writer.close()
    return received


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"GET /livez HT",
        b"GET /livez HTTP/1.1\r\n" + HOST + b"X-A: b\r\n",
        b"GET /livez HTTP/1.1\r\n" + HOST + b"\r\nGET /livez HTTP/1.1\r\nHo",
        b"POST /v1/sessions HTTP/1.1\r\n" + HOST + b"Content-Type: application/json\r\nContent-Length: 50\r\n\r\n{",
        b"GET /v1/sessions/x/stream HTTP/1.1\r\n" + HOST + b"Upgrade: websocket\r\nConnection: Upgrade\r\n",
    ],
    ids=["silent", "request line", "headers", "second head", "body", "handshake"],
)
async def test_a_connection_that_stops_midway_is_ended(wire: Wire, sent: bytes) -> None:
    await ended(await dial(wire, sent))
    assert (await wire.http.get("/livez")).status_code == 200


async def trickled_s(pair: Pair) -> float:
    """How long the server takes a byte now and then."""
    reader, writer = pair
    began = time.monotonic()
    with contextlib.suppress(ConnectionError):
        while not reader.at_eof() and time.monotonic() - began < PATIENCE_S:
            writer.write(b"a")
            await writer.drain()
            await asyncio.sleep(0.05)
    writer.close()
    return time.monotonic() - began


async def test_a_head_in_drops_has_one_time_for_all(wire: Wire) -> None:
    """Each byte in time, the whole never."""
    assert await trickled_s(await dial(wire, b"GET /livez HTTP/1.1\r\nX-A: ")) < PATIENCE_S


async def test_a_body_that_nobody_reads_has_its_time_too(wire: Wire) -> None:
    """The call is answered at once; what trickles in behind it does not keep the connection."""
    pair = await dial(wire, b"GET /livez HTTP/1.1\r\n" + HOST + b"Content-Length: 1000000\r\n\r\n")
    assert b"200 OK" in await pair[0].read(1000)
    assert await trickled_s(pair) < PATIENCE_S


@pytest.mark.parametrize(
    "head",
    [
        b"".join(b"X-%d: %s\r\n" % (n, b"a" * 1000) for n in range(100)),
        b"X-A: " + b"a" * 1_000_000,
        b"X-A\x00: b\r\n\r\n",
        b"Content-Length: abc\r\n\r\n",
        b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n",
    ],
    ids=["many headers", "endless header", "control character", "length", "smuggling"],
)
async def test_a_bad_head_is_a_problem(wire: Wire, head: bytes) -> None:
    received = await ended(await dial(wire, b"GET /livez HTTP/1.1\r\n" + HOST + head))
    if received:  # a reset may overtake the answer while we are still sending
        status, _, rest = received.partition(b"\r\n")
        assert status == b"HTTP/1.1 400 Bad Request"
        assert b"application/problem+json" in rest
        assert json.loads(rest.partition(b"\r\n\r\n")[2])["code"] == "bad-request"
    assert (await wire.http.get("/livez")).status_code == 200


async def test_who_does_not_read_the_answer_is_cut(serve: Serve, clip: Clip) -> None:
    """A large answer stays in our memory only for as long as it is being read."""
    wire = serve(send_timeout_s=2, max_frame_bytes=16 << 20)
    frame = _padded(clip.frames[0], 12 << 20)
    sid = (await wire.create(frame, clip.box))["id"]
    reader, writer = await asyncio.open_connection("127.0.0.1", wire.server.port, limit=4096)
    writer.write(b"GET /v1/sessions/%s/snapshot HTTP/1.1\r\n" % sid.encode() + HOST + b"\r\n")
    await asyncio.wait_for(reader.read(100), PATIENCE_S)
    await wire.http.aclose()
    assert _connections(wire) >= 1
    async with asyncio.timeout(PATIENCE_S):
        while _connections(wire):
            await asyncio.sleep(0.1)
    writer.close()


def _padded(jpeg: bytes, size: int) -> bytes:
    """The same image with comments that nobody looks at."""
    comment = b"\xff\xfe\xff\xff" + bytes(0xFFFD)
    return jpeg[:2] + comment * (size // len(comment)) + jpeg[2:]


def _connections(wire: Wire) -> int:
    """Established connections of the front."""
    connections = psutil.Process(wire.server.pid).net_connections("tcp")
    return sum(connection.status == psutil.CONN_ESTABLISHED for connection in connections)


async def test_too_many_connections_are_told_so(serve: Serve, clip: Clip) -> None:
    """A problem with the time to wait, for calls and handshakes; probes are answered; far too many are cut."""
    wire = serve(max_connections=6, head_timeout_s=PATIENCE_S)
    sid = (await wire.create(clip.frames[0], clip.box))["id"]
    async with wire.stream(sid) as stream:
        silent = [await dial(wire) for _ in range(6)]
        async with httpx2.AsyncClient(base_url=wire.server.url, timeout=PATIENCE_S) as late:
            response = await late.get("/v1/sessions")
            assert (response.status_code, response.json()["code"]) == (503, "at-capacity")
            assert int(response.headers["Retry-After"]) >= 1
            assert response.headers["Connection"] == "close"
            assert (await late.get("/livez")).status_code == 200
        with pytest.raises(InvalidStatus) as refused:
            async with wire.stream(sid, takeover="true"):
                pass
        assert refused.value.response.status_code == 503
        many: list[Any] = [await dial(wire) for _ in range(12)]
        assert await ended(many[-1]) == b""
        await stream.frame(clip.frames[1])  # who is there already is served
        await stream.hear("result")
        for _, writer in silent + many:
            writer.close()
    async with asyncio.timeout(PATIENCE_S):
        while (await wire.http.get("/v1/sessions")).status_code != 200:
            await asyncio.sleep(0.05)


async def test_an_upload_that_is_broken_off_leaves_no_trace(serve: Serve) -> None:
    """No fault, no session, and a line that says so."""
    wire = serve()
    head = b"POST /v1/sessions HTTP/1.1\r\n" + HOST + b"Content-Type: multipart/form-data; boundary=b\r\n"
    for rest in (b"Content-Length: 100000\r\n\r\n--b\r\n", b"Transfer-Encoding: chunked\r\n\r\n5\r\n--b\r\n"):
        for _ in range(3):
            _, writer = await dial(wire, head + rest)
            await writer.drain()
            reset(writer)
    async with asyncio.timeout(PATIENCE_S):
        while wire.server.log.count('"path": "/v1/sessions"') < 6:
            await asyncio.sleep(0.05)
    assert "Traceback" not in wire.server.log
    assert '"error"' not in wire.server.log
    assert (await wire.http.get("/v1/sessions")).json()["sessions"] == []


FORM_HEAD = b'--b\r\nContent-Disposition: form-data; name="frame"; filename="f"\r\n\r\n'
TOO_LARGE = [
    ("application/json", b"", "frame-too-large"),
    ("application/msgpack", b"", "frame-too-large"),
    ("multipart/form-data; boundary=b", FORM_HEAD, "frame-too-large"),
    ("application/vnd.mfcmt.snapshot", b"", "body-too-large"),
]


async def test_a_body_above_its_limit_is_refused_with_a_problem(serve: Serve) -> None:
    """Whether its length is told before or not: the same problem."""
    wire = serve(max_frame_bytes=1_000_000, max_snapshot_bytes=1_000_000)

    async def parts(head: bytes) -> AsyncIterator[bytes]:
        yield head
        for _ in range(200):
            yield bytes(10_000)

    for kind, head, code in TOO_LARGE:
        for content in (head + bytes(2_000_000), parts(head)):
            response = await wire.http.post("/v1/sessions", content=content, headers={"Content-Type": kind})
            assert (response.status_code, response.json()["code"]) == (413, code)
            assert response.headers["Content-Type"] == "application/problem+json"


async def test_bodies_that_are_being_received_have_a_bound_together(serve: Serve, clip: Clip) -> None:
    """Many clients that each send a large body slowly cannot fill the memory; what they held is free again."""
    wire = serve(max_upload_bytes=4_000_000, body_timeout_s=PATIENCE_S)
    head = b"POST /v1/sessions HTTP/1.1\r\n" + HOST + b"Content-Type: application/vnd.mfcmt.snapshot\r\n"
    starts = [head + b"Content-Length: %d\r\n\r\n" % (size + 1) + bytes(size) for size in (700_000, 500_000)]
    slow = [await dial(wire, start) for start in starts]
    async with asyncio.timeout(PATIENCE_S):
        while await under_way_bytes(wire) < 1_200_000:
            await asyncio.sleep(0.05)
    async with asyncio.timeout(PATIENCE_S):
        while (response := await wire.post(clip.frames[0] + bytes(900_000), clip.box)).status_code != 503:
            await asyncio.sleep(0.05)
    assert response.json()["code"] == "at-capacity"
    assert int(response.headers["Retry-After"]) >= 1
    for _, writer in slow:
        reset(writer)
    async with asyncio.timeout(PATIENCE_S):
        while (await wire.post(clip.frames[0] + bytes(900_000), clip.box)).status_code != 201:
            await asyncio.sleep(0.05)


async def test_of_two_bodies_at_once_that_do_not_both_fit_one_is_read(serve: Serve, clip: Clip) -> None:
    wire = serve(max_upload_bytes=4_000_000)
    await wire.create(clip.frames[0], clip.box)
    for _ in range(5):
        both = (wire.post(clip.frames[0] + bytes(1_400_000), clip.box) for _ in range(2))
        assert sorted(response.status_code for response in await asyncio.gather(*both)) in ([201, 201], [201, 503])


async def test_who_is_refused_while_sending_is_told_so(serve: Serve, clip: Clip) -> None:
    """The answer comes although the client reads it only after its whole body."""
    wire = serve(max_upload_bytes=24 * MIB, body_timeout_s=PATIENCE_S)
    head = b"POST /v1/sessions HTTP/1.1\r\n" + HOST + b"Content-Type: application/vnd.mfcmt.snapshot\r\n"
    fills = await dial(wire, head + b"Content-Length: %d\r\n\r\n" % (12 * MIB - 10_000))
    async with asyncio.timeout(PATIENCE_S):
        while await under_way_bytes(wire) < 11 * MIB:
            await asyncio.sleep(0.05)
        for _ in range(5):
            pair = await dial(wire, head + b"Content-Length: %d\r\n\r\n" % (8 * MIB))
            for _ in range(128):
                pair[1].write(bytes(MIB // 16))
                await pair[1].drain()
            received = await pair[0].read(65536)
            assert received.startswith(b"HTTP/1.1 503"), received
            assert b"at-capacity" in received
            pair[1].close()
    reset(fills[1])


async def test_nothing_is_inflated(serve: Serve, clip: Clip) -> None:
    """The extension is not negotiated, so that a small message cannot become a large one."""
    wire = serve()
    sid = (await wire.create(clip.frames[0], clip.box))["id"]
    async with connect(f"ws{wire.server.url[4:]}/v1/sessions/{sid}/stream", compression="deflate") as socket:
        assert socket.response is not None
        assert "Sec-WebSocket-Extensions" not in socket.response.headers
        assert not socket.protocol.extensions
