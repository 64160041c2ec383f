"""Bad frames, bad boxes, bad messages: the catalogue's answer, nothing changed, one line in the log."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import httpx2
import msgpack
import pytest

from service.client import AsyncClient, AsyncSession, Problem, Result
from service.client.types import read_answer
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.service.frames import images
from tests.service.wire.conftest import Stream

from .conftest import JSON, MSGPACK, attach, watch
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
async def test_a_bad_frame_is_refused_and_changes_nothing(
    server: OwnServer, client: AsyncClient, clip: Clip, way: str
) -> None:
    """After each of them the next good frame is tracked as if it had not been."""
    bad = bad_frames(clip.frames[1], clip.size)
    said = in_process(clip, [clip.box])
    await asyncio.sleep(1)  # of each kind of refusal so many lines a second are written; other tests had theirs
    with watch(server) as log:
        async with await client.create(clip.frames[0], clip.box) as session:
            if way == "http":
                await _over_http(session, clip, bad, said)
            else:
                mode = "latest" if way == "latest" else "lossless"
                protocol = MSGPACK if way == "latest" else way
                async with attach(server, session.id, protocol=protocol, mode=mode) as stream:
                    await _over_stream(stream, clip, bad, said)
        for name, (_, code, _) in bad.items():
            written = [record for record in log.lines(session=session.id) if record.get("code") == code]
            wanted = sum(1 for _, other, _ in bad.values() if other == code)
            assert len(written) == wanted, f"{name}: one line a refusal"


async def _over_stream(stream: Stream, clip: Clip, bad: dict[str, tuple[bytes, str, int]], said: list[Any]) -> None:
    seq = 0
    for index, (name, (data, code, status)) in enumerate(bad.items(), 1):
        await stream.frame(data)
        refused = await stream.hear("error")
        seq += 1
        problem = refused["problem"]
        assert (problem["code"], problem["status"], refused["seq"]) == (code, status, seq), name
        await stream.frame(clip.frames[index])
        seq += 1
        result = read_answer(Result, await stream.hear())
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


BAD_BOXES: list[list[float]] = [
    [math.nan, 0, 10, 10],
    [0, 0, math.inf, 10],
    [-math.inf, 0, 10, 10],
    [1e308, 1e308, 1e308, 1e308],
    [10, 10, 0, 10],
    [10, 10, 10, -5],
    [10, 10, 5e-324, 5e-324],
    [5000, 5000, 10, 10],
    [-80, 10, 100, 10],
]


@pytest.mark.parametrize("box", BAD_BOXES)
async def test_a_bad_box_is_refused_and_changes_nothing(
    server: OwnServer, client: AsyncClient, clip: Clip, box: list[float]
) -> None:
    """For a session, for a target over HTTP and in a stream; the session goes on as it was."""
    with watch(server):
        with pytest.raises(Problem) as refused:
            await client.create(clip.frames[0], box)
        assert refused.value.code == "bad-box"
        async with await client.create(clip.frames[0], clip.box) as session, attach(server, session.id) as stream:
            for control in ({"type": "add"}, {"type": "correct", "target": 0}):
                await stream.say(**control, box=box, ref="r")
                error = await stream.hear("error")
                problem = error["problem"]
                assert (problem["code"], problem["status"], error["ref"]) == ("bad-box", 422, "r")
            for path, method in (("targets", "POST"), ("targets/0", "PUT")):
                answer = await _msgpack_call(server, method, f"/v1/sessions/{session.id}/{path}", {"box": box})
                assert (answer.status_code, answer.json()["code"]) == (422, "bad-box")
            await stream.frame(clip.frames[1])
            result = read_answer(Result, await stream.hear())
            assert len(result.targets) == 1
            assert_same(result.target, in_process(clip, [clip.box])[0][0])


async def _msgpack_call(server: OwnServer, method: str, path: str, body: Any) -> httpx2.Response:
    async with httpx2.AsyncClient(base_url=server.url) as http:
        headers = {"Content-Type": "application/msgpack"}
        return await http.request(method, path, content=msgpack.packb(body), headers=headers)
