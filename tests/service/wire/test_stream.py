"""The stream: both subprotocols, both modes, controls, numbers, attachments, close codes."""

from __future__ import annotations

import json
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from service.load.clips import Clip

from .conftest import Serve, Wire

BOTH = pytest.mark.parametrize("protocol", ["mfcmt.v1.json", "mfcmt.v1.msgpack"])


@BOTH
async def test_lossless_answers_every_frame_in_order(wire: Wire, clip: Clip, protocol: str) -> None:
    session = await wire.create(clip.frames[0], clip.box, label="court 3")
    async with wire.stream(session["id"], protocols=[protocol], mode="lossless") as stream:
        ready = stream.ready
        assert ready["session"]["label"] == "court 3"
        assert ready["session"]["stream"]["attached"] is True
        assert (ready["mode"], ready["credit"], ready["region_lag"], ready["next_seq"]) == ("lossless", 4, 1, 1)
        for frame in clip.frames[1:5]:
            await stream.frame(frame, ts="t")
        results = [await stream.hear("result") for _ in range(4)]
    assert [r["seq"] for r in results] == [1, 2, 3, 4]
    assert {r["ts"] for r in results} == {"t"}
    assert all(r["dropped"] == 0 and r["size"] == list(clip.size) for r in results)
    assert all(t >= 0 for r in results for t in r["timing"].values())
    assert set(results[0]["targets"][0]) == {
        "id", "box", "status", "reliable", "flags", "scores", "psr", "updated", "scale", "confidence",
    }  # fmt: skip


@BOTH
async def test_one_frame_above_the_credit_is_refused_and_not_queued(wire: Wire, clip: Clip, protocol: str) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"], protocols=[protocol], mode="lossless") as stream:
        for frame in clip.frames[1:31]:
            await stream.frame(frame)
        answers = [await stream.hear() for _ in range(30)]
    refused = [a for a in answers if a["type"] == "error"]
    assert refused
    assert {a["problem"]["code"] for a in refused} == {"over-credit"}
    assert all(a["problem"]["retry_after_s"] > 0 for a in refused)
    assert sorted(a["seq"] for a in answers) == list(range(1, 31))


@BOTH
async def test_latest_tracks_the_newest_and_counts_the_superseded(wire: Wire, clip: Clip, protocol: str) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"], protocols=[protocol]) as stream:
        assert stream.ready["credit"] is None
        for frame in clip.frames[1:41]:
            await stream.frame(frame)
        results = []
        while not results or results[-1]["seq"] < 40:
            results.append(await stream.hear("result"))
    assert sum(r["dropped"] for r in results) + len(results) == 40
    assert len(results) < 40
    seqs = [r["seq"] for r in results]
    assert seqs == sorted(seqs)


@BOTH
async def test_controls_act_between_frames_in_order(wire: Wire, clip: Clip, protocol: str) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    x, y, w, h = clip.box
    async with wire.stream(session["id"], protocols=[protocol], mode="lossless") as stream:
        await stream.say(type="add", box=[x, y, w / 2, h], ref="a1")
        await stream.frame(clip.frames[1])
        await stream.say(type="correct", target=0, box=[x, y, w, h], ref=2)
        await stream.say(type="remove", target=1)
        await stream.say(type="remove", target=1, ref="again")
        await stream.frame(clip.frames[2])
        added = await stream.hear("targets")
        assert (added["ref"], [t["id"] for t in added["targets"]]) == ("a1", [0, 1])
        assert (await stream.hear("result"))["seq"] == 1
        corrected = await stream.hear("targets")
        assert corrected["ref"] == 2
        assert corrected["targets"][0]["box"] == pytest.approx([x, y, w, h])
        assert corrected["targets"][0]["reliable"] is None
        removed = await stream.hear("targets")
        assert "ref" not in removed
        assert [t["id"] for t in removed["targets"]] == [0]
        refused = await stream.hear("error")
        assert (refused["ref"], refused["problem"]["code"]) == ("again", "target-not-found")
        assert [t["id"] for t in (await stream.hear("result"))["targets"]] == [0]
        await stream.say(type="add", box=[x, y, w, h])
        assert [t["id"] for t in (await stream.hear("targets"))["targets"]] == [0, 2]


@BOTH
async def test_on_next_acts_on_the_frame_that_comes(wire: Wire, clip: Clip, protocol: str) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    x, y, w, h = clip.box
    async with wire.stream(session["id"], protocols=[protocol], mode="lossless") as stream:
        await stream.say(type="correct", target=0, box=[x + 1, y, w, h], on="next", ref="c")
        await stream.say(type="add", box=[x, y, 2 * w, h], on="next", ref="a")
        await stream.say(type="remove", target=9, on="next", ref="r")
        await stream.say(type="add", box=[-5000, 0, 10, 10], on="next", ref="b")
        await stream.frame(clip.frames[1])
        answers = [await stream.hear() for _ in range(5)]
        assert [(a["type"], a.get("ref")) for a in answers] == [
            ("targets", "c"), ("targets", "a"), ("error", "r"), ("error", "b"), ("result", None),
        ]  # fmt: skip
        assert [a["problem"]["code"] for a in answers[2:4]] == ["target-not-found", "bad-box"]
        result = answers[-1]
        assert [t["box"] for t in result["targets"]] == [[x + 1, y, w, h], [x, y, 2 * w, h]]
        assert all(t["flags"] is None and t["scale"] == 1 for t in result["targets"])
        await stream.frame(clip.frames[2])
        assert all(t["flags"] for t in (await stream.hear("result"))["targets"])


async def test_on_next_goes_down_with_its_frame(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"], mode="lossless") as stream:
        for broken, code in ((b"no image", "unsupported-image"), (clip.frames[1][:-300], "frame-undecodable")):
            await stream.say(type="add", box=list(clip.box), on="next", ref="a")
            await stream.frame(broken)
            frame, control = await stream.hear("error"), await stream.hear("error")
            assert (frame["problem"]["code"], control["problem"]["code"]) == (code, code)
            assert control["ref"] == "a"
        await stream.frame(clip.frames[1])
        result = await stream.hear("result")
        assert (result["seq"], len(result["targets"])) == (3, 1)


async def test_a_frame_with_controls_is_not_superseded(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"]) as stream:
        for n, frame in enumerate(clip.frames[1:21], 1):
            if n == 5:
                await stream.say(type="correct", target=0, box=list(clip.box), on="next")
            await stream.frame(frame)
        results = []
        while not results or results[-1]["seq"] < 20:
            message = await stream.hear()
            if message["type"] == "result":
                results.append(message)
    assert 5 in [r["seq"] for r in results]
    assert next(r for r in results if r["seq"] == 5)["targets"][0]["box"] == pytest.approx(list(clip.box))


@BOTH
async def test_numbers_belong_to_the_session(wire: Wire, clip: Clip, protocol: str) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    sid = session["id"]
    async with wire.stream(sid, protocols=[protocol], mode="lossless") as stream:
        await stream.frame(clip.frames[1], seq=7)
        assert (await stream.hear("result"))["seq"] == 7
        await stream.frame(clip.frames[2], seq=7)
        stale = await stream.hear("error")
        assert (stale["seq"], stale["problem"]["code"]) == (7, "stale-frame")
        await stream.frame(clip.frames[2])
        assert (await stream.hear("result"))["seq"] == 8
        await stream.frame(b"no image")
        assert (await stream.hear("error"))["seq"] == 9
    assert (await wire.track(sid, clip.frames[3])).json()["seq"] == 10
    assert (await wire.track(sid, b"no image")).status_code == 415
    async with wire.stream(sid, protocols=[protocol]) as stream:
        assert stream.ready["session"]["seq"] == 10
        assert stream.ready["next_seq"] == 12
        await stream.frame(clip.frames[4])
        assert (await stream.hear("result"))["seq"] == 12


async def test_what_is_wrong_in_a_message_is_an_error_and_changes_nothing(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({}, "bad-request"),
        ({"type": "jump"}, "bad-request"),
        ({"type": ["add"]}, "bad-request"),
        ({"type": "add"}, "bad-request"),
        ({"type": "add", "box": [1, 2, 3]}, "bad-request"),
        ({"type": "add", "box": [1, 2, 3, "4"]}, "bad-request"),
        ({"type": "add", "box": [1, 2, 3, True]}, "bad-request"),
        ({"type": "add", "box": [1, 2, 0, 4]}, "bad-box"),
        ({"type": "add", "box": [1, 2, 3, 10**400]}, "bad-box"),
        ({"type": "add", "box": [10_000, 2, 3, 4]}, "bad-box"),
        ({"type": "add", "box": [1, 2, 30, 40], "ref": {"a": 1}}, "bad-request"),
        ({"type": "add", "box": [1, 2, 30, 40], "on": "now"}, "bad-request"),
        ({"type": "add", "box": [1, 2, 30, 40], "colour": "red"}, "bad-request"),
        ({"type": "correct", "box": [1, 2, 30, 40]}, "bad-request"),
        ({"type": "correct", "target": 5, "box": [1, 2, 30, 40]}, "target-not-found"),
        ({"type": "remove", "target": -1}, "bad-request"),
        ({"type": "meta", "seq": -1}, "bad-request"),
        ({"type": "meta", "seq": 1.5}, "bad-request"),
        ({"type": "meta", "seq": 2**53}, "bad-request"),
        ({"type": "meta", "ts": "t" * 65}, "bad-request"),
        ({"type": "meta", "region": [0, 0, 10]}, "bad-request"),
        ({"type": "meta", "region": [0, 0, 0, 0]}, "bad-region"),
        ({"type": "frame", "frame": "text"}, "bad-request"),
    ]
    async with wire.stream(session["id"], mode="lossless") as stream:
        for message, code in wrong:
            await stream.say(**message)
            assert await stream.refused() == code, message
        await stream.say(type="add", ref="x" * 70, box=[1, 2, 30, 40])
        assert "ref" not in await stream.hear("error")
        await stream.say(type="add", ref="kept", box=[1, 2, 30])
        assert (await stream.hear("error"))["ref"] == "kept"
        await stream.socket.send('{"type":"add","box":[1,2,3,1e999]}')
        assert await stream.refused() == "bad-box"
        await stream.frame(clip.frames[1])
        result = await stream.hear("result")
        assert (result["seq"], len(result["targets"])) == (1, 1)


@pytest.mark.parametrize(
    ("protocol", "message"),
    [
        ("mfcmt.v1.json", "no json"),
        ("mfcmt.v1.json", "[1]"),
        ("mfcmt.v1.json", '{"type":"add","box":[NaN,1,1,1]}'),
        ("mfcmt.v1.json", '{"type":"add","type":"add"}'),
        ("mfcmt.v1.json", "[" * 50_000),
        ("mfcmt.v1.json", '{"type":"add"}' + " " * 70_000),
        ("mfcmt.v1.msgpack", "text"),
        ("mfcmt.v1.msgpack", b"\xc1"),
        ("mfcmt.v1.msgpack", b"\x93\x01\x02\x03"),
        ("mfcmt.v1.msgpack", b"\x81\xa4type"),
        ("mfcmt.v1.msgpack", b"\x91" * 100_000),
        ("mfcmt.v1.msgpack", b"\xdd\xff\xff\xff\xff"),
        ("mfcmt.v1.msgpack", b"\x81\xa4type\xc7\x01\x05\x00"),
    ],
)
async def test_an_unreadable_message_closes_with_4400(
    wire: Wire, clip: Clip, protocol: str, message: str | bytes
) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"], protocols=[protocol]) as stream:
        await stream.socket.send(message)
        assert await stream.closed() == 4400
    async with wire.stream(session["id"], protocols=[protocol], mode="lossless") as stream:
        await stream.frame(clip.frames[1])
        await stream.hear("result")


async def test_a_second_attachment_needs_takeover(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    sid = session["id"]
    async with wire.stream(sid, mode="lossless") as first:
        with pytest.raises(InvalidStatus) as refused:
            async with wire.stream(sid):
                pass
        assert refused.value.response.status_code == 409
        assert json.loads(refused.value.response.body or b"")["code"] == "attached-elsewhere"
        response = await wire.track(sid, clip.frames[1])
        assert (response.status_code, response.json()["code"]) == (409, "attached-elsewhere")
        await first.frame(clip.frames[1])
        async with wire.stream(sid, mode="lossless", takeover="true") as second:
            assert await first.closed() == 4409
            # The frame in work is finished and kept, or it was still on its way and is not.
            reached = second.ready["session"]["seq"]
            await second.frame(clip.frames[2])
            assert (await second.hear("result"))["seq"] > reached
            with pytest.raises(InvalidStatus):
                async with wire.stream(sid, resume=first.ready["attachment"]):
                    pass
            async with wire.stream(sid, resume=second.ready["attachment"]) as third:
                assert await second.closed() == 4409
                assert third.ready["session"]["seq"] == reached + 1 or third.ready["next_seq"] > reached


async def test_http_acts_between_frames_and_the_stream_is_told(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    path = f"/v1/sessions/{session['id']}"
    async with wire.stream(session["id"], mode="lossless") as stream:
        added = await wire.http.post(f"{path}/targets", json={"box": list(clip.box)})
        assert added.status_code == 201
        message = await stream.hear("targets")
        assert [t["id"] for t in message["targets"]] == [0, 1]
        assert message["region"] == added.json()["region"]
        assert "ref" not in message
        assert (await wire.http.delete(f"{path}/targets/1")).status_code == 204
        assert len((await stream.hear("targets"))["targets"]) == 1
        assert (await wire.http.get(path)).json()["stream"]["attached"] is True
        assert (await wire.http.delete(path)).status_code == 204
        assert await stream.closed() == 1000
    assert (await wire.http.get(path)).json()["reason"] == "closed"


async def test_a_message_above_the_limit_is_refused_and_above_twice_that_closes(serve: Serve, clip: Clip) -> None:
    wire = serve(max_frame_bytes=100_000)
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"], mode="lossless") as stream:
        await stream.frame(clip.frames[1][:3] + bytes(150_000))
        assert await stream.refused() == "frame-too-large"
        await stream.frame(clip.frames[1])
        await stream.hear("result")
        await stream.frame(bytes(300_000))
        assert await stream.closed() == 1009


async def test_too_many_messages_close_the_stream_with_4429(serve: Serve, clip: Clip) -> None:
    wire = serve(max_messages_per_s=20, max_refused_messages=30)
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"]) as stream:
        for _ in range(20):
            await stream.say(type="remove", target=3)
            assert await stream.refused() == "target-not-found"
        for _ in range(100):
            await stream.say(type="remove", target=3)
        assert await stream.refused() in ("rate-limited", "target-not-found")
        assert await stream.closed() == 4429


async def test_idle_streams_end_with_4408_and_sessions_without_stream_are_gone(serve: Serve, clip: Clip) -> None:
    wire = serve(attached_idle_timeout_s=1)
    session = await wire.create(clip.frames[0], clip.box)
    brief = await wire.create(clip.frames[0], clip.box, idle_timeout_s=1)
    async with wire.stream(session["id"]) as stream:
        assert await stream.closed() == 4408
    for sid in (session["id"], brief["id"]):
        response = await wire.http.get(f"/v1/sessions/{sid}")
        assert (response.status_code, response.json()["reason"]) == (410, "idle")


async def test_a_refused_handshake_is_answered_with_a_problem(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    for sid, query, status, code in (
        ("unknown", {}, 404, "session-not-found"),
        (session["id"], {"mode": "fast"}, 400, "bad-request"),
        (session["id"], {"takeover": "yes"}, 400, "bad-request"),
    ):
        with pytest.raises(InvalidStatus) as refused:
            async with wire.stream(sid, **query):
                pass
        assert refused.value.response.status_code == status
        assert refused.value.response.headers["Content-Type"] == "application/problem+json"
        assert refused.value.response.headers["X-Request-ID"]
        assert json.loads(refused.value.response.body or b"")["code"] == code


@BOTH
async def test_browsers_are_told_after_the_handshake(wire: Wire, clip: Clip, protocol: str) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    own, foreign = wire.server.url, "https://evil.example"
    for sid, origin, code, close in (
        (session["id"], foreign, "origin-refused", 4403),
        ("unknown", own, "session-not-found", 4404),
    ):
        async with wire.stream(sid, protocols=[protocol], headers={"Origin": origin}) as stream:
            assert await stream.refused() == code
            assert await stream.closed() == close
    async with wire.stream(session["id"], protocols=[protocol], headers={"Origin": own}) as stream:
        await stream.hear("ready")
