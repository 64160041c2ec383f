"""The HTTP calls: bodies, answers, media types, ids, pages."""

from __future__ import annotations

import asyncio
import base64
import json
from typing import Any

import msgpack
import pytest

from mfcmt_core import MFCMT
from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip

from .conftest import Wire, problem

SNAPSHOT = "application/vnd.mfcmt.snapshot"


async def test_a_session_from_every_kind_of_body(wire: Wire, clip: Clip) -> None:
    frame, box = clip.frames[0], list(clip.box)
    text = ",".join(str(v) for v in box)
    bodies: list[dict[str, Any]] = [
        {"files": {"frame": frame}, "data": {"box": text}},
        {"files": {"frame": frame}, "data": {"box": json.dumps(box), "options": '{"label":"l"}'}},
        {"files": {"frame": frame}, "data": {"boxes": json.dumps([box])}},
        {"json": {"frame": base64.b64encode(frame).decode(), "box": box}},
        {
            "content": msgpack.packb({"frame": frame, "boxes": [box], "options": {"label": "l"}}),
            "headers": {"Content-Type": "application/msgpack"},
        },
    ]
    for body in bodies:
        response = await wire.http.post("/v1/sessions", **body)
        assert response.status_code == 201, response.text
        answer = response.json()
        assert response.headers["Location"] == f"/v1/sessions/{answer['id']}"
        assert len(base64.urlsafe_b64decode(answer["id"])) >= 16
        assert answer["targets"][0]["box"] == pytest.approx(box)
        assert (answer["seq"], answer["size"], answer["preset"]) == (0, list(clip.size), "default")
        assert answer["stream"] == {
            "url": f"ws{wire.server.url[4:]}/v1/sessions/{answer['id']}/stream",
            "attached": False,
        }


async def test_bad_bodies_are_told_and_leave_nothing(wire: Wire, clip: Clip) -> None:
    frame, box = clip.frames[0], list(clip.box)
    coded = base64.b64encode(frame).decode()
    form = {"files": {"frame": frame}}
    large = base64.b64encode(frame[:3] + bytes(300_000)).decode()
    before = _active((await wire.http.get("/metrics")).text)
    cases: list[tuple[dict[str, Any], tuple[int, str]]] = [
        ({"json": {"frame": coded}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": box, "boxes": [box]}}, (400, "bad-request")),
        ({"json": {"frame": coded, "boxes": []}}, (400, "bad-request")),
        ({"json": {"frame": "no base64!", "box": box}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": box, "colour": 1}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": box, "options": {"colour": 1}}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": box, "options": {"preset": "best"}}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": box, "options": {"maps": 1}}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": box, "options": {"idle_timeout_s": 1e9}}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": box, "options": {"label": "x" * 201}}}, (400, "bad-request")),
        ({"json": [1]}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": [1, 2, 3]}}, (400, "bad-request")),
        ({"json": {"frame": coded, "box": [0, 0, 0, 5]}}, (422, "bad-box")),
        ({"json": {"frame": coded, "box": [5000, 0, 5, 5]}}, (422, "bad-box")),
        ({"json": {"frame": coded, "boxes": [box] * 17}}, (422, "too-many-targets")),
        ({"files": {"frame": frame[:3] + bytes(9 << 20)}, "data": {"box": "1,2,3,4"}}, (413, "frame-too-large")),
        ({"json": {"frame": large, "box": box}}, (413, "frame-too-large")),
        ({"json": {"frame": base64.b64encode(b"GIF89a").decode(), "box": box}}, (415, "unsupported-image")),
        ({"json": {"frame": coded[:-400], "box": box}}, (422, "frame-undecodable")),
        ({"content": b"{", "headers": {"Content-Type": "application/json"}}, (400, "bad-request")),
        ({"content": b'{"a":NaN}', "headers": {"Content-Type": "application/json"}}, (400, "bad-request")),
        ({"content": b"\xc1", "headers": {"Content-Type": "application/msgpack"}}, (400, "bad-request")),
        ({"content": b"x", "headers": {"Content-Type": "text/plain"}}, (415, "unsupported-media-type")),
        ({"content": frame, "headers": {"Content-Type": "image/jpeg"}}, (415, "unsupported-media-type")),
        ({"content": b"x", "headers": {"Content-Type": "multipart/form-data"}}, (400, "bad-request")),
        ({**form, "data": {"box": "nan,1,2,3"}}, (422, "bad-box")),
        ({**form, "data": {"box": "1;2;3;4"}}, (400, "bad-request")),
        ({**form, "data": {"box": "[1,2"}}, (400, "bad-request")),
        ({**form, "data": {"box": "1,2,3,4", "colour": "red"}}, (400, "bad-request")),
        ({"files": {"picture": frame}, "data": {"box": "1,2,3,4"}}, (400, "bad-request")),
        ({"content": b"junk", "headers": {"Content-Type": SNAPSHOT}}, (422, "bad-snapshot")),
    ]
    for body, expected in cases:
        response = await wire.http.post("/v1/sessions", **body)
        assert problem(response) == expected, (body, response.text)
    assert _active((await wire.http.get("/metrics")).text) == before


def _active(metrics: str) -> str:
    return next(line for line in metrics.splitlines() if line.startswith("mfcmt_sessions_active "))


async def test_frames_over_http_give_the_boxes_of_the_library(wire: Wire, clip: Clip) -> None:
    x, y, w, h = clip.box
    boxes = [clip.box, (x, y + h / 3, w / 2, h / 2)]
    session = await wire.create(clip.frames[0], *boxes)
    path = f"/v1/sessions/{session['id']}/frames"
    trackers = [MFCMT(), MFCMT()]
    for tracker, box in zip(trackers, boxes, strict=True):
        tracker.init(decode(clip.frames[0], LIMITS)[0], box)
    packed = {"Content-Type": "application/msgpack", "Accept": "application/msgpack"}
    for n, frame in enumerate(clip.frames[1:25], 1):
        match n % 3:
            case 0:
                response = await wire.track(session["id"], frame, ts="1.5")
                result = response.json()
            case 1:
                response = await wire.http.post(path, files={"frame": frame}, params={"seq": n})
                result = response.json()
            case _:
                content = msgpack.packb({"frame": frame, "seq": n, "ts": 1.5})
                response = await wire.http.post(path, content=content, headers=packed)
                result = msgpack.unpackb(response.content)
        assert response.status_code == 200, response.text
        image, _ = decode(frame, LIMITS)
        assert result["seq"] == n
        for answer, tracker in zip(result["targets"], trackers, strict=True):
            said = tracker.update(image)
            assert tuple(answer["box"]) == said.box
            assert (answer["status"], answer["psr"], answer["scale"]) == (said.status, said.psr, said.scale)


async def test_bad_frames_over_http_are_refused_with_their_code(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    sid = session["id"]
    other = (await asyncio.to_thread(_resized, clip.frames[1]), clip.frames[1])
    cases = [
        (b"", {}, (415, "unsupported-image")),
        (b"GIF89a", {}, (415, "unsupported-image")),
        (clip.frames[1][:-200], {}, (422, "frame-undecodable")),
        (clip.frames[1][:3] + bytes(9 << 20), {}, (413, "frame-too-large")),
        (other[0], {}, (422, "frame-size-changed")),
        (clip.frames[1], {"seq": 0}, (409, "stale-frame")),
        (clip.frames[1], {"seq": "x"}, (400, "bad-request")),
        (clip.frames[1], {"ts": "x" * 65}, (400, "bad-request")),
        (clip.frames[1], {"region": "1,2,3"}, (400, "bad-request")),
        (clip.frames[1], {"region": "0,0,1.5,2"}, (400, "bad-request")),
        (clip.frames[1], {"region": "nan,0,1,2"}, (400, "bad-request")),
        (clip.frames[1], {"region": "0,0,5,5"}, (422, "bad-region")),
    ]
    for frame, params, expected in cases:
        assert problem(await wire.track(sid, frame, **params)) == expected
    undisturbed = await wire.create(clip.frames[0], clip.box)
    result = (await wire.track(sid, clip.frames[1])).json()
    assert result["targets"] == (await wire.track(undisturbed["id"], clip.frames[1])).json()["targets"]


def _resized(frame: bytes) -> bytes:
    import cv2

    image, _ = decode(frame, LIMITS)
    return bytes(cv2.imencode(".png", cv2.resize(image, None, fx=0.5, fy=0.5))[1])


async def test_another_size_starts_the_targets_anew_where_asked(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box, on_resize="rescale")
    half = await asyncio.to_thread(_resized, clip.frames[1])
    result = (await wire.track(session["id"], half)).json()
    assert result["size"] == [v // 2 for v in clip.size]
    assert result["targets"][0]["box"] == pytest.approx([v / 2 for v in clip.box], abs=0.5)
    assert (result["targets"][0]["flags"], result["targets"][0]["scale"]) == (None, 1)
    again = (await wire.track(session["id"], await asyncio.to_thread(_resized, clip.frames[2]))).json()
    assert again["targets"][0]["flags"] is not None


async def test_targets_are_added_corrected_and_removed(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    path = f"/v1/sessions/{session['id']}/targets"
    box = list(clip.box)
    added = await wire.http.post(path, json={"box": box})
    assert added.status_code == 201
    assert added.json()["target"]["id"] == 1
    assert added.json()["region"]
    await wire.track(session["id"], clip.frames[1])
    corrected = await wire.http.put(f"{path}/1", json={"box": [box[0] + 2, *box[1:]]})
    assert corrected.status_code == 200
    assert corrected.json()["target"]["box"] == pytest.approx([box[0] + 2, *box[1:]])
    packed = await wire.http.put(
        f"{path}/1",
        content=msgpack.packb({"box": box}),
        headers={"Content-Type": "application/msgpack", "Accept": "application/msgpack"},
    )
    assert msgpack.unpackb(packed.content)["target"]["scale"] == 1
    assert (await wire.http.delete(f"{path}/1")).status_code == 204
    assert problem(await wire.http.delete(f"{path}/1")) == (404, "target-not-found")
    assert problem(await wire.http.put(f"{path}/1", json={"box": box})) == (404, "target-not-found")
    assert problem(await wire.http.put(f"{path}/x", json={"box": box})) == (400, "bad-request")
    assert problem(await wire.http.post(path, json={"box": [9999, 0, 5, 5]})) == (422, "bad-box")
    assert problem(await wire.http.post(path, json={})) == (400, "bad-request")
    for _ in range(15):
        assert (await wire.http.post(path, json={"box": box})).status_code == 201
    assert problem(await wire.http.post(path, json={"box": box})) == (422, "too-many-targets")
    assert (await wire.http.delete(f"{path}/0")).status_code == 204
    answer = (await wire.http.get(f"/v1/sessions/{session['id']}")).json()
    assert [t["id"] for t in answer["targets"]] == list(range(2, 17))


async def test_a_session_without_targets_goes_on(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    path = f"/v1/sessions/{session['id']}"
    await wire.http.delete(f"{path}/targets/0")
    result = (await wire.track(session["id"], clip.frames[1])).json()
    assert (result["targets"], result["region"]) == ([], None)
    added = (await wire.http.post(f"{path}/targets", json={"box": list(clip.box)})).json()
    assert added["target"]["id"] == 1


async def test_the_same_key_and_body_give_the_same_session(wire: Wire, clip: Clip) -> None:
    key = {"Idempotency-Key": "create-1"}
    answers = await asyncio.gather(*(wire.post(clip.frames[0], clip.box, headers=key, label="x") for _ in range(5)))
    assert {a.status_code for a in answers} == {201}
    assert len({a.json()["id"] for a in answers}) == 1
    assert problem(await wire.post(clip.frames[1], clip.box, headers=key)) == (400, "bad-request")
    assert problem(await wire.post(clip.frames[0], clip.box, headers={"Idempotency-Key": "x" * 256})) == (
        400, "bad-request",
    )  # fmt: skip
    refused = {"Idempotency-Key": "create-2"}
    assert problem(await wire.post(clip.frames[0], (9999, 0, 5, 5), headers=refused)) == (422, "bad-box")
    assert (await wire.post(clip.frames[0], clip.box, headers=refused)).status_code == 201


async def test_sessions_are_listed_in_pages_and_end_for_good(wire: Wire, clip: Clip) -> None:
    made = [(await wire.create(clip.frames[0], clip.box))["id"] for _ in range(3)]
    seen: list[str] = []
    after = ""
    while True:
        page = (await wire.http.get("/v1/sessions", params={"limit": 2, "after": after})).json()
        seen += [s["id"] for s in page["sessions"]]
        assert len(page["sessions"]) <= 2
        if page["next"] is None:
            break
        after = page["next"]
    assert [sid for sid in seen if sid in made] == made
    assert len(seen) == len(set(seen))
    path = f"/v1/sessions/{made[0]}"
    assert [(await wire.http.delete(path)).status_code for _ in range(2)] == [204, 204]
    for call in (wire.http.get(path), wire.track(made[0], clip.frames[1]), wire.http.get(f"{path}/snapshot")):
        assert problem(await call) == (410, "session-gone")
    assert problem(await wire.http.delete("/v1/sessions/never-was")) == (404, "session-not-found")
    assert problem(await wire.http.get("/v1/sessions", params={"limit": 0})) == (400, "bad-request")


async def test_what_is_no_call_is_a_problem(wire: Wire) -> None:
    assert problem(await wire.http.get("/v1/nothing")) == (404, "not-found")
    refused = await wire.http.patch("/v1/sessions")
    assert problem(refused) == (405, "method-not-allowed")
    assert set(refused.headers["allow"].replace(" ", "").split(",")) >= {"GET"}
    assert problem(await wire.http.get("/v1/capabilities", headers={"Accept": "text/html"})) == (
        406, "not-acceptable",
    )  # fmt: skip
    kept = await wire.http.get("/livez", headers={"X-Request-ID": "abc-1"})
    assert kept.headers["X-Request-ID"] == "abc-1"
    replaced = await wire.http.get("/livez", headers={"X-Request-ID": "a b<c>"})
    assert replaced.headers["X-Request-ID"] != "a b<c>"


async def test_capabilities_and_health_are_answered(wire: Wire) -> None:
    answer = (await wire.http.get("/v1/capabilities")).json()
    assert (answer["protocol"], answer["presets"]) == (1, ["default", "paper"])
    assert answer["image_types"] == ["image/jpeg", "image/png", "image/webp"]
    assert answer["limits"]["max_frame_bytes"] == 8 * 1024 * 1024
    assert {"mfcmt", "numpy", "opencv", "numba"} <= set(answer["software"])
    packed = await wire.http.get("/v1/capabilities", headers={"Accept": "application/msgpack"})
    assert msgpack.unpackb(packed.content) == answer
    for path in ("/livez", "/readyz"):
        response = await wire.http.get(path)
        assert (response.status_code, response.json()["status"]) == (200, "ok")


async def test_pages_and_contracts_need_nothing_from_elsewhere(wire: Wire) -> None:
    page = await wire.http.get("/docs")
    assert page.headers["content-security-policy"].startswith("default-src 'none'")
    assert "<script" not in page.text
    assert "src=" not in page.text
    assert 'id="bad-box"' in page.text
    assert (await wire.http.get("/openapi.json")).json()["openapi"].startswith("3.1")
    assert (await wire.http.get("/asyncapi.json")).json()["asyncapi"] == "3.0.0"


async def test_metrics_count_frames_and_name_no_session(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    await wire.track(session["id"], clip.frames[1])
    response = await wire.http.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain")
    for name in (
        "mfcmt_sessions_active",
        "mfcmt_sessions_capacity 128.0",
        "mfcmt_frames_received_total{",
        "mfcmt_frame_total_seconds_bucket{",
        "mfcmt_lane_rss_bytes{",
        "mfcmt_build_info{",
        'path="/v1/sessions/{session_id}/frames"',
    ):
        assert name in response.text
    assert session["id"] not in response.text
