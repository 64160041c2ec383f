"""Bad frames, bad boxes, bad messages: the catalogue's answer, nothing changed, one line in the log."""

from __future__ import annotations

import json
import math
from typing import Any

import httpx2
import msgpack
import pytest
from websockets.exceptions import InvalidStatus

from service.client import AsyncClient, AsyncSession, Problem, Result
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.service.frames import images

from .conftest import Serve, watch
from .raw import JSON, MSGPACK, Raw, attach
from .test_main_job import assert_same, in_process

MIB = 1 << 20


def bad_frames(good: bytes, size: tuple[int, int]) -> dict[str, tuple[bytes, str, int]]:
    """Every way to send a frame that is not one: bytes, code, status."""
    jpeg, png, webp = images.jpeg(), images.encode(".png", images.picture()), images.encode(".webp", images.picture())
    turned = images.encode(".jpg", images.picture(size[1], size[0]))
    own_png = images.encode(".png", images.picture(*size))
    return {
        "empty": (b"", "unsupported-image", 415),
        "text": (b"hello", "unsupported-image", 415),
        "gif": (images.encode(".gif", images.picture()), "unsupported-image", 415),
        "bmp": (images.encode(".bmp", images.picture()), "unsupported-image", 415),
        "tiff": (images.encode(".tiff", images.picture()), "unsupported-image", 415),
        "truncated": (good[: len(good) // 2], "frame-undecodable", 422),
        "truncated, end glued on": (good[: len(good) // 2] + b"\xff\xd9", "frame-undecodable", 422),
        "no pixels": (images.with_size(jpeg, 0, 0), "frame-undecodable", 422),
        "12 bits": (images.patched(jpeg, images.sof(jpeg) + 4, 12), "frame-undecodable", 422),
        "arithmetic": (images.patched(jpeg, images.sof(jpeg) + 1, 0xC9), "frame-undecodable", 422),
        "animated png": (png[:33] + images.chunk(b"acTL", bytes(8)) + png[33:], "frame-undecodable", 422),
        "animated webp": (images.riff(images.vp8x(160, 120, 2), webp[12:]), "frame-undecodable", 422),
        "damaged png": (images.patched(own_png, 60, own_png[60] ^ 0xFF), "frame-undecodable", 422),
        "too many bytes": (good + bytes(8 * MIB), "frame-too-large", 413),
        "pixel bomb": (images.with_size(jpeg, 32000, 32000), "frame-too-large", 413),
        "png bomb": (images.png_header(12000, 12000), "frame-too-large", 413),
        "scan bomb": (images.scan_bomb(500), "frame-too-large", 413),
        "another size": (jpeg, "frame-size-changed", 422),
        "turned": (turned, "frame-size-changed", 422),
    }


@pytest.mark.parametrize("way", [MSGPACK, JSON, "latest", "http"])
async def test_bad_frames(server: OwnServer, client: AsyncClient, clip: Clip, way: str) -> None:
    """After each of them the next good frame is tracked as if it had not been."""
    bad = bad_frames(clip.frames[1], clip.size)
    said = in_process(clip, [clip.box])
    with watch(server) as log:
        async with await client.create(clip.frames[0], clip.box) as session:
            if way == "http":
                await _over_http(session, clip, bad, said)
            else:
                mode = "latest" if way == "latest" else "lossless"
                protocol = MSGPACK if way == "latest" else way
                async with attach(server, session.id, protocol=protocol, mode=mode) as raw:
                    await _over_stream(raw, clip, bad, said)
        for name, (_, code, _) in bad.items():
            told = [record for record in log.lines(session=session.id) if record.get("code") == code]
            wanted = sum(1 for _, other, _ in bad.values() if other == code)
            assert len(told) == wanted, f"{name}: one line a refusal"


async def _over_stream(raw: Raw, clip: Clip, bad: dict[str, tuple[bytes, str, int]], said: list[Any]) -> None:
    seq = 0
    for index, (name, (data, code, status)) in enumerate(bad.items(), 1):
        await raw.frame(data)
        problem = await raw.problem()
        seq += 1
        assert (problem["code"], problem["status"], problem["seq"]) == (code, status, seq), name
        await raw.frame(clip.frames[index])
        seq += 1
        result = Result.of(await raw.receive())
        assert result.seq == seq
        assert result.dropped == 0
        assert_same(result.target, said[index - 1][0])


async def _over_http(
    session: AsyncSession, clip: Clip, bad: dict[str, tuple[bytes, str, int]], said: list[Any]
) -> None:
    for index, (name, (data, code, status)) in enumerate(bad.items(), 1):
        before = await session.refresh()
        with pytest.raises(Problem) as refused:
            await session.track(data)
        assert (refused.value.code, refused.value.status) == (code, status), name
        after = await session.refresh()
        assert (after.seq, after.targets, after.region) == (before.seq, before.targets, before.region)
        assert_same((await session.track(clip.frames[index])).target, said[index - 1][0])


@pytest.mark.parametrize("name", ["truncated", "text", "pixel bomb", "scan bomb", "no pixels"])
async def test_a_session_cannot_begin_with_a_bad_frame(
    server: OwnServer, client: AsyncClient, clip: Clip, name: str
) -> None:
    data, code, status = bad_frames(clip.frames[1], clip.size)[name]
    with watch(server):
        with pytest.raises(Problem) as refused:
            await client.create(data, clip.box)
        assert (refused.value.code, refused.value.status) == (code, status)


BAD_BOXES: list[tuple[list[float], str]] = [
    ([math.nan, 0, 10, 10], "bad-box"),
    ([0, 0, math.inf, 10], "bad-box"),
    ([-math.inf, 0, 10, 10], "bad-box"),
    ([1e308, 1e308, 1e308, 1e308], "bad-box"),
    ([10, 10, 0, 10], "bad-box"),
    ([10, 10, 10, -5], "bad-box"),
    ([10, 10, 5e-324, 5e-324], "bad-box"),
    ([5000, 5000, 10, 10], "bad-box"),
    ([-80, 10, 100, 10], "bad-box"),
]


@pytest.mark.parametrize(("box", "code"), BAD_BOXES)
async def test_bad_boxes(server: OwnServer, client: AsyncClient, clip: Clip, box: list[float], code: str) -> None:
    """For a session, for a target over HTTP and in a stream; the session goes on as it was."""
    with watch(server):
        with pytest.raises(Problem) as refused:
            await client.create(clip.frames[0], box)
        assert refused.value.code == code
        async with await client.create(clip.frames[0], clip.box) as session, attach(server, session.id) as raw:
            for control in ({"type": "add"}, {"type": "correct", "target": 0}):
                await raw.send(control | {"box": box, "ref": "r"})
                problem = await raw.problem()
                assert (problem["code"], problem["status"], problem["ref"]) == (code, 422, "r")
            for path, method in (("targets", "POST"), ("targets/0", "PUT")):
                answer = await _msgpack_call(server, method, f"/v1/sessions/{session.id}/{path}", {"box": box})
                assert (answer.status_code, answer.json()["code"]) == (422, code)
            await raw.frame(clip.frames[1])
            result = Result.of(await raw.receive())
            assert len(result.targets) == 1
            assert_same(result.target, in_process(clip, [clip.box])[0][0])


async def _msgpack_call(server: OwnServer, method: str, path: str, body: Any) -> httpx2.Response:
    async with httpx2.AsyncClient(base_url=server.url) as http:
        headers = {"Content-Type": "application/msgpack"}
        return await http.request(method, path, content=msgpack.packb(body), headers=headers)


@pytest.mark.parametrize(
    ("box", "codes"),
    [
        ("[NaN, 0, 10, 10]", {"bad-request", "bad-box"}),
        ("[1e999, 0, 10, 10]", {"bad-box"}),
        ('["10", 0, 10, 10]', {"bad-request"}),
        ("[10, 10, 10]", {"bad-request"}),
        ("{}", {"bad-request"}),
        ("null", {"bad-request"}),
    ],
)
async def test_bad_boxes_in_json(server: OwnServer, client: AsyncClient, clip: Clip, box: str, codes: set[str]) -> None:
    async with await client.create(clip.frames[0], clip.box) as session:
        with watch(server):
            async with httpx2.AsyncClient(base_url=server.url) as http:
                answer = await http.post(
                    f"/v1/sessions/{session.id}/targets",
                    content=f'{{"box": {box}}}',
                    headers={"Content-Type": "application/json"},
                )
            assert answer.status_code in (400, 422)
            assert answer.headers["Content-Type"].startswith("application/problem+json")
            assert answer.json()["code"] in codes
            assert answer.headers["X-Request-ID"]
        assert len((await session.refresh()).targets) == 1


UNREADABLE = {
    "text that is no JSON": (JSON, "no json"),
    "JSON with NaN": (JSON, '{"type": "add", "box": [NaN, 1, 1, 1]}'),
    "JSON that is no map": (JSON, "[1, 2]"),
    "deep JSON": (JSON, "[" * 60_000),
    "text in msgpack": (MSGPACK, "text"),
    "broken msgpack": (MSGPACK, b"\xc1"),
    "cut msgpack": (MSGPACK, b"\x82\xa4type"),
    "empty msgpack": (MSGPACK, b""),
    "msgpack that is no map": (MSGPACK, b"\x93\x01\x02\x03"),
    "array bomb": (MSGPACK, b"\xdd\xff\xff\xff\xff"),
    "map bomb": (MSGPACK, b"\xdf\xff\xff\xff\xff"),
    "deep msgpack": (MSGPACK, b"\x91" * 100_000),
    "extension type": (MSGPACK, msgpack.packb({"type": msgpack.ExtType(5, b"x")})),
    "two messages in one": (MSGPACK, msgpack.packb({"type": "x"}) * 2),
    "doubled key": (MSGPACK, b"\x82\xa4type\xa5frame\xa4type\xa5frame"),
}


@pytest.mark.parametrize("name", UNREADABLE)
async def test_unreadable_messages_end_the_stream(
    server: OwnServer, client: AsyncClient, clip: Clip, name: str
) -> None:
    """4400; the session lives on."""
    protocol, message = UNREADABLE[name]
    async with await client.create(clip.frames[0], clip.box) as session:
        with watch(server) as log:
            async with attach(server, session.id, protocol=protocol) as raw:
                await raw.socket.send(message)
                assert await raw.closed() == 4400
            async with attach(server, session.id) as raw:
                await raw.frame(clip.frames[1])
                assert_same(Result.of(await raw.receive()).target, in_process(clip, [clip.box])[0][0])
        assert len([r for r in log.lines(session=session.id) if r.get("close_code") == 4400]) <= 1


REFUSED: dict[str, dict[str, Any]] = {
    "unknown type": {"type": "jump"},
    "no type": {"box": [1, 1, 10, 10]},
    "type of another type": {"type": 5},
    "unknown field": {"type": "remove", "target": 0, "colour": 1},
    "no box": {"type": "add"},
    "no target": {"type": "correct", "box": [1, 1, 10, 10]},
    "target of another type": {"type": "remove", "target": "0"},
    "target that is true": {"type": "remove", "target": True},
    "on what": {"type": "add", "box": [1, 1, 10, 10], "on": "last"},
}


BAD_META: list[dict[str, Any]] = [
    {"seq": -1},
    {"seq": 2**60},
    {"seq": 1.5},
    {"ts": "x" * 65},
    {"ts": [1]},
    {"region": [1, 2]},
]


@pytest.mark.parametrize("protocol", [MSGPACK, JSON])
async def test_refused_messages(server: OwnServer, client: AsyncClient, clip: Clip, protocol: str) -> None:
    """An error with the message's own ref; the stream goes on."""
    async with await client.create(clip.frames[0], clip.box) as session:
        with watch(server):
            async with attach(server, session.id, protocol=protocol) as raw:
                for name, message in REFUSED.items():
                    await raw.send(message | {"ref": name})
                    problem = await raw.problem()
                    assert (problem["code"], problem["status"], problem["ref"]) == ("bad-request", 400, name)
                await raw.send({"type": "remove", "target": 4, "ref": 1})
                problem = await raw.problem()
                assert (problem["code"], problem["ref"]) == ("target-not-found", 1)
                for beside in (
                    {"seq": -1},
                    {"seq": 2**60},
                    {"seq": 1.5},
                    {"ts": "x" * 65},
                    {"ts": [1]},
                    {"region": [1, 2]},
                ):
                    kind = {"type": "frame", "frame": b""} if raw.binary else {"type": "meta"}
                    await raw.send(kind | beside)
                    assert (await raw.problem())["code"] == "bad-request", beside
                await raw.frame(clip.frames[1])
                assert_same(Result.of(await raw.receive()).target, in_process(clip, [clip.box])[0][0])


async def test_frame_of_another_type_in_msgpack(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    async with await client.create(clip.frames[0], clip.box) as session, attach(server, session.id) as raw:
        for frame in ("text", None, 5, [1]):
            await raw.send({"type": "frame", "frame": frame})
            assert (await raw.problem())["code"] == "bad-request"


async def test_frame_sizes(serve: Serve, clip: Clip) -> None:
    """Up to the limit, up to twice the limit, above."""
    limit = max(map(len, clip.frames)) + 100
    server = serve(max_frame_bytes=limit)
    with watch(server):
        async with AsyncClient(server.url) as client, await client.create(clip.frames[0], clip.box) as session:
            async with attach(server, session.id) as raw:
                await raw.frame(clip.frames[1] + bytes(limit - len(clip.frames[1])))
                assert (await raw.receive())["type"] == "result"
                await raw.frame(clip.frames[1] + bytes(limit + 1 - len(clip.frames[1])))
                assert (await raw.problem())["code"] == "frame-too-large"
                await raw.frame(bytes(2 * limit - 200))
                assert (await raw.problem())["code"] == "frame-too-large"
                await raw.frame(clip.frames[2])
                assert (await raw.receive())["type"] == "result"
                await raw.socket.send(bytes(2 * limit + 10_000))
                assert await raw.closed() == 1009
            assert (await session.refresh()).seq == 4
            with pytest.raises(Problem) as refused:
                await session.track(bytes(limit + 1))
            assert refused.value.code == "frame-too-large"


async def test_sequence_numbers(server: OwnServer, client: AsyncClient, clip: Clip) -> None:
    """Strictly rising, gaps allowed, of the session and not of the attachment."""
    async with await client.create(clip.frames[0], clip.box) as session, attach(server, session.id) as raw:
        await raw.frame(clip.frames[1], seq=5)
        assert (await raw.receive())["seq"] == 5
        for stale in (5, 4, 0):
            await raw.frame(clip.frames[2], seq=stale)
            problem = await raw.problem()
            assert (problem["code"], problem["status"], problem["seq"]) == ("stale-frame", 409, stale)
        await raw.frame(b"refused")
        assert (await raw.problem())["seq"] == 6
        await raw.frame(clip.frames[2])
        assert (await raw.receive())["seq"] == 7
        await raw.frame(clip.frames[3], seq=2**53 - 1)
        assert (await raw.receive())["seq"] == 2**53 - 1


async def test_unknown_and_foreign_ids(serve: Serve, clip: Clip) -> None:
    """Another's session answers as one that does not exist, down to the body."""
    keys = ["first-key-of-sixteen", "other-key-of-sixteen"]
    server = serve(api_keys=",".join(keys))
    with watch(server) as log:
        async with AsyncClient(server.url, key=keys[0]) as mine, AsyncClient(server.url, key=keys[1]) as other:
            session = await mine.create(clip.frames[0], clip.box)
            assert [s.id async for s in other.sessions()] == []
            assert [s.id async for s in mine.sessions()] == [session.id]
            sid = session.id
            calls = [
                ("GET", ""),
                ("DELETE", ""),
                ("POST", "/frames"),
                ("POST", "/targets"),
                ("PUT", "/targets/0"),
                ("DELETE", "/targets/0"),
                ("GET", "/trajectory"),
                ("GET", "/snapshot"),
                ("POST", "/ticket"),
            ]
            for method, path in calls:
                body: dict[str, Any] = {"json": {"box": [1, 1, 10, 10]}} if "targets" in path else {}
                if path == "/frames":
                    body = {"content": clip.frames[1], "headers": {"Content-Type": "image/jpeg"}}
                seen = []
                for name in (sid, "never-was"):
                    with pytest.raises(Problem) as refused:
                        await other.call(method, f"/v1/sessions/{name}{path}", **body)
                    members = refused.value.members
                    seen.append({n: v for n, v in members.items() if n not in ("request_id", "instance")})
                assert seen[0] == seen[1], path
                assert seen[0]["code"] == "session-not-found"
            for key in (keys[1], keys[0]):
                name = sid if key == keys[1] else "never-was"
                with pytest.raises(InvalidStatus) as denied:
                    async with attach(server, name, headers={"Authorization": f"Bearer {key}"}):
                        pass
                assert denied.value.response.status_code == 404
                assert json.loads(denied.value.response.body or b"")["code"] == "session-not-found"
            for bad in (None, "wrong-key-of-sixteen"):
                async with AsyncClient(server.url, key=bad) as nobody:
                    with pytest.raises(Problem) as refused:
                        await nobody.session(sid)
                    assert (refused.value.code, refused.value.status) == ("unauthenticated", 401)
            assert (await session.refresh()).seq == 0
        for key in keys:
            assert key not in log.text


async def test_tickets(serve: Serve, clip: Clip) -> None:
    """A ticket admits one handshake of its session, and is not logged."""
    key = "first-key-of-sixteen"
    server = serve(api_keys=key)
    with watch(server) as log:
        async with AsyncClient(server.url, key=key) as client:
            session = await client.create(clip.frames[0], clip.box)
            other = await client.create(clip.frames[0], clip.box)
            ticket = (await session.ticket()).ticket
            offered = [MSGPACK, f"mfcmt.ticket.{ticket}"]
            async with attach(server, session.id, subprotocols=offered) as raw:
                assert raw.socket.subprotocol == MSGPACK
                await raw.frame(clip.frames[1])
                assert (await raw.receive())["seq"] == 1
            with pytest.raises(InvalidStatus) as denied:
                async with attach(server, session.id, subprotocols=offered):
                    pass
            assert denied.value.response.status_code == 401
            strange = (await session.ticket()).ticket
            with pytest.raises(InvalidStatus):
                async with attach(server, other.id, subprotocols=[MSGPACK, f"mfcmt.ticket.{strange}"]):
                    pass
        assert ticket not in log.text
        assert strange not in log.text


async def test_browser_origins(serve: Serve, clip: Clip) -> None:
    """A browser cannot read a refused handshake: it is told by a message and a close code."""
    server = serve(allowed_origins="https://app.example")
    async with AsyncClient(server.url) as client:
        session = await client.create(clip.frames[0], clip.box)
        for origin, code, problem in (
            ("https://evil.example", 4403, "origin-refused"),
            ("null", 4403, "origin-refused"),
        ):
            async with attach(server, session.id, headers={"Origin": origin}, ready=False) as raw:
                assert (await raw.problem())["code"] == problem
                assert await raw.closed() == code
        for origin in ("https://app.example", server.url):
            async with attach(server, session.id, headers={"Origin": origin}) as raw:
                await raw.frame(clip.frames[1])
                assert (await raw.receive())["type"] == "result"
        async with attach(server, "never-was", headers={"Origin": server.url}, ready=False) as raw:
            assert (await raw.problem())["code"] == "session-not-found"
            assert await raw.closed() == 4404
