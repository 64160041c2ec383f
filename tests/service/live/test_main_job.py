"""A session with the first frame and a box, a stream of frames, and the tracker's very boxes back."""

from __future__ import annotations

import json

import msgpack
import pytest
from websockets.asyncio.client import connect

from mfcmt_core import MFCMT, TrackResult
from mfcmt_core.images.decode import decode
from service.client import AsyncClient, Client, Frame, Result, Target
from service.client.connection import Protocol
from service.load.clips import LIMITS, Clip
from service.load.own import OwnServer

from .conftest import watch


def in_process(clip: Clip, boxes: list[tuple[float, float, float, float]]) -> list[list[TrackResult]]:
    """What the library says of the same frames: a list of targets for each frame after the first."""
    first, _ = decode(clip.frames[0], LIMITS)
    trackers = [MFCMT() for _ in boxes]
    for tracker, box in zip(trackers, boxes, strict=True):
        tracker.init(first, box)
    said = []
    for frame in clip.frames[1:]:
        image, _ = decode(frame, LIMITS)
        said.append([tracker.update(image) for tracker in trackers])
    return said


def assert_same(target: Target, said: TrackResult) -> None:
    """Number for number."""
    assert target.box == said.box
    for name in ("status", "reliable", "psr", "updated", "scale"):
        assert getattr(target, name) == getattr(said, name)
    if said.flags is None or said.scores is None:
        assert target.flags is None
        assert target.scores is None
        return
    assert target.flags is not None
    assert target.scores is not None
    for name in ("fused", "template", "statistical"):
        assert getattr(target.flags, name) == getattr(said.flags, name)
        assert getattr(target.scores, name) == getattr(said.scores, name)


@pytest.mark.parametrize("protocol", ["mfcmt.v1.msgpack", "mfcmt.v1.json"])
async def test_boxes_are_those_of_the_library(
    server: OwnServer, client: AsyncClient, clip: Clip, protocol: Protocol
) -> None:
    with watch(server):
        async with await client.create(clip.frames[0], clip.box, label="main job") as session:
            assert session.info.label == "main job"
            assert session.info.seq == 0
            assert session.info.size == clip.size
            stream = session.stream(clip.frames[1:], mode="lossless", protocol=protocol)
            results = [result async for result in stream]
            assert [r.seq for r in results] == list(range(1, len(clip.frames)))
            for result, said in zip(results, in_process(clip, [clip.box]), strict=True):
                assert_same(result.target, said[0])
                assert result.size == clip.size
                assert result.dropped == 0
                assert result.timing is not None
                assert result.timing.decode_ms > 0
            assert (await session.refresh()).seq == len(clip.frames) - 1
            past = await session.trajectory()
            assert [r.seq for r in past] == list(range(len(clip.frames)))
            assert [r.target.box for r in past[1:]] == [r.target.box for r in results]


async def test_several_targets_over_http_have_the_boxes_of_the_library(client: AsyncClient, clip: Clip) -> None:
    x, y, w, h = clip.box
    boxes = [clip.box, (x + w / 2, y, w, h), (x, y + h / 3, w / 2, h / 2)]
    async with await client.create(clip.frames[0], boxes=boxes) as session:
        assert [t.id for t in session.info.targets] == [0, 1, 2]
        for frame, said in zip(clip.frames[1:20], in_process(clip, boxes), strict=False):
            result = await session.track(Frame(frame, ts="camera 1"))
            assert result.ts == "camera 1"
            for target, one in zip(result.targets, said, strict=True):
                assert_same(target, one)


def test_the_client_without_asyncio_gives_the_boxes_of_the_library(server: OwnServer, clip: Clip) -> None:
    with Client(server.url) as client, client.create(clip.frames[0], clip.box) as session:
        assert session.id in [info.id for info in client.sessions()]
        assert client.session(session.id).info.seq == 0
        assert client.capabilities()
        lazily = (frame for frame in clip.frames[1:30])
        results: list[Result] = list(session.stream(lazily, mode="lossless"))
        for result, said in zip(results, in_process(clip, [clip.box]), strict=False):
            assert_same(result.target, said[0])
        assert len(results) == 29
        assert len(session.trajectory("otb", target=0).splitlines()) == 30
        with session.stream(mode="lossless") as stream:
            stream.send(clip.frames[30])
            assert next(stream).seq == 30
            corrected = stream.correct(0, clip.box)
            assert corrected.targets[0].box == pytest.approx(clip.box)
            assert corrected.targets[0].reliable is None
            added = stream.add(clip.box)
            assert [t.id for t in added.targets] == [0, 1]
            assert [t.id for t in stream.remove(1).targets] == [0]
            stream.finish()
            assert list(stream) == []
        assert session.track(clip.frames[31]).seq == 31
        assert session.add_target(clip.box).target.id == 2
        assert session.correct_target(2, clip.box).target.scale == 1
        session.remove_target(2)
        restored = client.restore(session.snapshot())
        with restored:
            assert restored.info.seq == 31
            assert restored.track(clip.frames[32]).target == session.track(clip.frames[32]).target


async def test_a_bare_websocket_speaks_json_without_our_client(
    server: OwnServer, client: AsyncClient, clip: Clip
) -> None:
    """The protocol as it stands, with nothing of our client: JSON when no subprotocol is named."""
    async with await client.create(clip.frames[0], clip.box) as session:
        url = f"ws{server.url[4:]}/v1/sessions/{session.id}/stream?mode=lossless"
        async with connect(url) as socket:
            assert socket.response is not None
            assert "Sec-WebSocket-Extensions" not in socket.response.headers
            ready = json.loads(await socket.recv())
            assert ready["type"] == "ready"
            assert ready["session"]["id"] == session.id
            assert ready["mode"] == "lossless"
            assert ready["credit"] >= 1
            assert ready["region_lag"] == 1
            await socket.send(clip.frames[1])
            result = json.loads(await socket.recv())
            assert set(result) >= {"type", "seq", "ts", "size", "dropped", "region", "targets", "timing"}
            assert (result["type"], result["seq"], result["ts"]) == ("result", 1, None)
            await socket.send(json.dumps({"type": "meta", "seq": 10, "ts": 1.5}))
            await socket.send(clip.frames[2])
            result = json.loads(await socket.recv())
            assert (result["seq"], result["ts"]) == (10, 1.5)
        async with connect(url, subprotocols=["mfcmt.v1.msgpack"]) as socket:  # type: ignore[list-item]
            assert socket.subprotocol == "mfcmt.v1.msgpack"
            assert msgpack.unpackb(await socket.recv())["session"]["seq"] == 10
            await socket.send(msgpack.packb({"type": "frame", "frame": clip.frames[3], "ts": "a"}))
            result = msgpack.unpackb(await socket.recv())
            assert (result["seq"], result["ts"]) == (11, "a")
