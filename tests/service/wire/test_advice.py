"""What a newcomer does wrong, and that the answer says what to do."""

from __future__ import annotations

import base64
import json
import subprocess
import sys
import time
from typing import Any

import httpx2
import msgpack
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from service.load.clips import Clip
from service.load.own import free_port

from .conftest import Wire, problem

JPEG = {"Content-Type": "image/jpeg"}
FORM = {"Content-Type": "application/x-www-form-urlencoded"}
MAIN = "import sys; from mfcmt_core.cli import main; sys.exit(main())"


def in_form(**files: Any) -> dict[str, Any]:
    return {"files": files, "data": {"box": "129,80,64,78"}}


async def test_a_wrong_session_is_told_what_is_wrong_and_what_to_do(wire: Wire, clip: Clip) -> None:
    frame, box = clip.frames[0], list(clip.box)
    coded = base64.b64encode(frame).decode()
    packed = {"content": msgpack.packb({"box": box}), "headers": {"Content-Type": "application/msgpack"}}
    cases: list[tuple[dict[str, Any], str, str]] = [
        ({}, "bad-request", "the body is empty; send the first frame and a box"),
        ({"headers": {"Content-Type": "application/json"}}, "bad-request", "the body is empty"),
        (in_form(image=frame), "bad-request", "the image goes into the field frame, not image"),
        (in_form(frame=frame, image=frame), "bad-request", "more than one file; only frame is a file"),
        ({"files": {"frame": frame, "box": b"1,2,3,4"}}, "bad-request", "more than one file"),
        ({"files": {"box": b"1,2,3,4"}}, "bad-request", "box is a text field, not a file"),
        ({"files": {"frame": (None, "0001.jpg")}, "data": {"box": "1,2,3,4"}}, "bad-request", "frame=@frame.jpg"),
        ({"files": {"options": (None, "{}")}}, "bad-request", "the image is missing: it is a file in the field frame"),
        ({"files": {"frame": frame}, "data": {"bbox": "1,2,3,4"}}, "bad-request", "one of box (x, y, w, h)"),
        (
            {"files": {"frame": frame}, "data": {"box": "1,2,3,4", "colour": "red"}},
            "bad-request",
            "unknown field 'colour'; the fields are frame, box, boxes, options",
        ),
        ({"files": {"frame": frame}, "data": {"box": "129 80 64 78"}}, "bad-request", "with commas between, x,y,w,h"),
        ({"json": {"box": box}}, "bad-request", "frame is missing; it is the image in base64"),
        (packed, "bad-request", "frame is missing; it is the image's bytes (bin)"),
        (
            {"json": {"frame": f"data:image/jpeg;base64,{coded}", "box": box}},
            "bad-request",
            "leave out everything up to the comma",
        ),
        ({"json": {"frame": f"{coded[:76]}\n{coded[76:]}", "box": box}}, "bad-request", "without line breaks"),
        ({"json": {"frame": coded, "box": "1,2,3,4"}}, "bad-request", "not a text with them: leave out the quotes"),
        ({"json": {"frame": coded, "box": ["1", "2", "3", "4"]}}, "bad-request", "not texts: leave out the quotes"),
        ({"json": {"frame": coded, "box": {"x": 1}}}, "bad-request", "four numbers, [x, y, w, h], not a map"),
        ({"json": {"frame": coded, "box": [1, 2, 3]}}, "bad-request", "four numbers, [x, y, w, h], not 3"),
        ({"content": frame, "headers": JPEG}, "unsupported-media-type", "curl -F frame=@frame.jpg -F box=x,y,w,h"),
        ({"content": frame, "headers": FORM}, "unsupported-media-type", "curl -F frame=@frame.jpg -F box=x,y,w,h"),
    ]
    for body, code, advice in cases:
        response = await wire.http.post("/v1/sessions", **body)
        assert problem(response)[1] == code, response.text
        assert advice in response.json()["detail"], response.text


async def test_a_wrong_frame_is_told_what_to_send(wire: Wire, clip: Clip) -> None:
    path = f"/v1/sessions/{(await wire.create(clip.frames[0], clip.box))['id']}"
    empty = await wire.http.post(f"{path}/frames", headers=JPEG)
    assert problem(empty) == (415, "unsupported-image")
    assert "the body is empty" in empty.json()["detail"]
    unnamed = await wire.http.post(f"{path}/frames", content=clip.frames[1], headers=FORM)
    assert problem(unnamed) == (415, "unsupported-media-type")
    assert "-H 'Content-Type: image/jpeg' --data-binary" in unnamed.json()["detail"]
    other = await wire.http.post(f"{path}/frames", files={"image": clip.frames[1]})
    assert "the image goes into the field frame, not image" in other.json()["detail"]
    target = await wire.http.post(f"{path}/targets")
    assert "four numbers, [x, y, w, h]; none is given" in target.json()["detail"]


async def test_a_bad_box_says_the_frames_size_and_the_order_and_knows_corners(wire: Wire, clip: Clip) -> None:
    width, height = clip.size
    cases = [
        ((width + 9, 5, 30, 30), f"in the frame of {width}x{height}; a box is x, y, w, h", False),
        ((width - 60, height - 70, width - 20, height - 10), "fit as corners x1, y1, x2, y2: then w is x2 - x1", True),
        ((0.4, 0.33, 0.2, 0.32), "in pixels and not shares of the frame", False),
        ((9, 9, 0, 5), "w and h are above 0; a box is x, y, w, h", False),
    ]
    session = await wire.create(clip.frames[0], clip.box)
    for box, advice, corners in cases:
        refused = await wire.post(clip.frames[0], box)
        assert problem(refused) == (422, "bad-box"), refused.text
        assert advice in refused.json()["detail"]
        assert ("corners" in refused.json()["detail"]) == corners
        assert "it is (" not in refused.json()["detail"]  # details are logged, and boxes never are
        added = await wire.http.post(f"/v1/sessions/{session['id']}/targets", json={"box": list(box)})
        assert added.json()["detail"] == refused.json()["detail"]
    assert refused.json()["title"] == "The box cannot be tracked"


async def test_a_websocket_at_another_path_is_a_404_problem_with_a_request_id(wire: Wire) -> None:
    for path in ("/", "/v1/sessions", "/v1/sessions/x/streams", "/stream", "/v1/sessions/x/stream/"):
        with pytest.raises(InvalidStatus) as refused:
            async with connect(f"ws{wire.server.url[4:]}{path}"):
                pass
        response = refused.value.response
        assert (response.status_code, response.headers["content-type"]) == (404, "application/problem+json")
        assert response.headers["x-request-id"]
        body = json.loads(response.body or b"")
        assert body["code"] == "not-found"
        assert "/v1/sessions/{session_id}/stream" in body["detail"]
    origin = {"Origin": wire.server.url}  # a browser cannot read the answer, so the socket says it
    async with connect(f"ws{wire.server.url[4:]}/v1/ws", additional_headers=origin) as socket:
        assert json.loads(await socket.recv())["problem"]["code"] == "not-found"
        with pytest.raises(ConnectionClosed):
            await socket.recv()
        assert socket.close_code == 4404
    call = await wire.http.get("/v1/sessions/x/stream")
    assert problem(call) == (404, "not-found")
    assert "ws://" in call.json()["detail"]


@pytest.mark.parametrize(
    ("protocol", "what", "advice"),
    [
        ("json", "base64", "send the bytes of the JPEG as a binary message"),
        ("json", "data:", "send the bytes of the JPEG as a binary message"),
        ("msgpack", "text", "send binary messages, or ask for mfcmt.v1.json"),
        ("msgpack", "bytes", '{"type": "frame", "frame": bytes}'),
    ],
)
async def test_a_frame_sent_the_wrong_way_closes_the_stream_and_says_the_right_way(
    wire: Wire, clip: Clip, protocol: str, what: str, advice: str
) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    coded = base64.b64encode(clip.frames[1]).decode()
    sent = {"base64": coded, "data:": f"data:image/jpeg;base64,{coded}", "text": "{}", "bytes": clip.frames[1]}[what]
    async with wire.stream(session["id"], protocols=[f"mfcmt.v1.{protocol}"]) as stream:
        await stream.socket.send(sent)
        assert await stream.closed() == 4400
        assert advice in (stream.socket.close_reason or "")


async def test_a_frame_in_a_json_message_is_told_to_be_binary(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"]) as stream:
        await stream.say(type="frame", frame="/9j/4AAQ")
        assert "a frame is a binary message" in (await stream.hear("error"))["problem"]["detail"]
        await stream.say(type="add", box="1,2,3,4")
        assert "leave out the quotes" in (await stream.hear("error"))["problem"]["detail"]


async def test_every_get_has_its_head(wire: Wire, clip: Clip) -> None:
    sid = (await wire.create(clip.frames[0], clip.box))["id"]
    paths = ["/", "/livez", "/readyz", "/metrics", "/docs", "/openapi.json", "/asyncapi.json", "/v1/capabilities"]
    paths += ["/static/client/mfcmt.js", "/v1/sessions"]
    paths += [f"/v1/sessions/{sid}{rest}" for rest in ("", "/trajectory", "/trajectory?format=csv", "/snapshot")]
    for path in paths:
        got, head = await wire.http.get(path), await wire.http.head(path)
        assert (head.status_code, head.content) == (200, b""), path
        assert head.headers["content-type"] == got.headers["content-type"]
        if path in ("/", "/livez", "/docs"):
            assert head.headers["content-length"] == got.headers["content-length"]
    missing = await wire.http.head("/v1/nothing")
    assert (missing.status_code, missing.content) == (404, b"")
    refused = await wire.http.post("/livez")
    assert refused.headers["allow"] == "GET, HEAD"
    nowhere = await wire.http.head(f"/v1/sessions/{sid}/frames")
    assert (nowhere.status_code, nowhere.headers["allow"]) == (405, "POST")
    metrics = (await wire.http.get("/metrics")).text
    assert 'mfcmt_http_requests_total{method="HEAD",path="/livez",status="200"}' in metrics
    # The connection goes on: nothing of a body is left on it.
    assert (await wire.http.get("/livez")).json()["status"] == "ok"


def test_a_service_that_has_just_started_says_that_no_lane_is_ready_yet(clip: Clip) -> None:
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, "serve", "--port", str(port), "--lanes", "1"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    answers: list[httpx2.Response] = []
    try:
        with httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=30) as http:
            give_up = time.monotonic() + 180
            while not (answers and answers[-1].status_code == 201) and time.monotonic() < give_up:
                try:
                    files, data = {"frame": clip.frames[0]}, {"box": ",".join(map(str, clip.box))}
                    answers.append(http.post("/v1/sessions", files=files, data=data))
                except httpx2.TransportError:
                    pass
                time.sleep(0.02)
    finally:
        process.terminate()
        process.wait()
    assert answers[-1].status_code == 201, answers[-1].text
    assert problem(answers[0]) == (503, "at-capacity")
    assert answers[0].json()["detail"].startswith("no lane is ready yet: the service has just started")
    assert answers[0].headers["Retry-After"] == "1"
