"""Nothing is left to be loaded on the event loop once the service is ready: it would hold up every stream."""

from __future__ import annotations

import asyncio
import base64
import json
from typing import Any

import msgpack

from service.load.clips import Clip
from service.load.own import OwnServer
from tests.tools.siege.traffic import MIB, padded

from .conftest import Wire

KEY = "the-key-of-these-tests"
LOADED = "loaded late: "
# Runs in the server before it starts: from when it listens, it prints each module that the main thread looks for.
TELL = """
import gc, sys, threading
freeze = gc.freeze
class Tell:
    def find_spec(self, name, path=None, target=None):
        if threading.current_thread() is threading.main_thread():
            print("loaded late: " + name, flush=True)
def freeze_and_tell():
    freeze()
    sys.meta_path.insert(0, Tell())
gc.freeze = freeze_and_tell
"""


async def test_no_call_or_stream_loads_a_module(clip: Clip) -> None:
    with OwnServer(prelude=TELL, lanes=1, api_keys=KEY, bridges="kserve,cvat,labelstudio") as server:
        async with Wire(server, {"X-API-Key": KEY}) as wire:
            for path in ("/", "/docs", "/openapi.json", "/metrics", "/readyz", "/v1/capabilities", "/nothing"):
                await wire.http.get(path)
            await every_call(wire, clip)
            await calls_of_bridges(wire, clip)
            sid = (await wire.create(clip.frames[0], clip.box))["id"]
            for number, protocol in enumerate(("mfcmt.v1.json", "mfcmt.v1.msgpack"), start=1):
                async with wire.stream(sid, protocols=[protocol]) as stream:
                    await stream.frame(clip.frames[number])
                    await stream.hear("result")
                    await stream.say(type="nonsense")
                    assert await stream.refused() == "bad-request"
        assert [line for line in server.log.splitlines() if line.startswith(LOADED)] == []


async def calls_of_bridges(wire: Wire, clip: Clip) -> None:
    """Start and go on by each bridge, and be refused by the one that would fetch a video."""
    frame, pixels = clip.frames[0], bytes(3 * 64 * 48)
    for shape, data in (([len(frame)], frame), ([48, 64, 3], pixels)):
        tensor = {"name": "FRAME", "datatype": "UINT8", "shape": shape, "parameters": {"binary_data_size": len(data)}}
        box = {"name": "BOX", "datatype": "FP32", "shape": [4], "data": [1, 2, 30, 40]}
        parameters = {"sequence_id": 1, "sequence_start": True, "binary_data_output": True}
        head = json.dumps({"inputs": [tensor, box], "parameters": parameters}).encode()
        sent = {"Inference-Header-Content-Length": str(len(head))}
        begun = await wire.http.post("/v2/models/mfcmt/infer", content=head + data, headers=sent)
        assert begun.status_code == 200, begun.text
    call = {"image": base64.b64encode(frame).decode(), "shapes": [[1, 2, 31, 42]], "states": []}
    for _ in range(2):
        answer = await wire.http.post("/api/function_invocations", json=call)
        assert answer.status_code == 200, answer.text
        call["states"] = answer.json()["states"]
    for path in ("/v2", "/v2/models/mfcmt", "/api/functions", "/labelstudio/health"):
        assert (await wire.http.get(path)).status_code == 200
    keyframe = {"frame": 1, "x": 1, "y": 2, "width": 30, "height": 40}
    value = {"framesCount": 9, "duration": 1, "sequence": [keyframe]}
    region = {"id": "r", "type": "videorectangle", "from_name": "box", "to_name": "video", "value": value}
    task = {"data": {"video": "http://videos.example/clip.mp4"}}
    config = '<Video name="video" value="$video"/>'
    sent_to = {"tasks": [task], "label_config": config, "params": {"context": {"result": [region]}}}
    assert (await wire.http.post("/labelstudio/predict", json=sent_to)).status_code == 400


async def every_call(wire: Wire, clip: Clip) -> None:
    """Make every call once, in each form of its body and of its answer."""
    bodies: list[dict[str, Any]] = [
        {"files": {"frame": clip.frames[0]}, "data": {"box": "1,2,30,40"}},
        {"json": {"frame": "no base64", "box": [1, 2, 30, 40]}},
        {
            "content": msgpack.packb({"frame": clip.frames[0], "box": [1, 2, 30, 40]}),
            "headers": {"Content-Type": "application/msgpack", "Idempotency-Key": "once"},
        },
    ]
    posts = [await wire.http.post("/v1/sessions", **body) for body in [*bodies, bodies[-1]]]
    assert [post.status_code for post in posts] == [201, 400, 201, 201]
    at = f"/v1/sessions/{posts[0].json()['id']}"
    for frame in (clip.frames[1], padded(clip.frames[2], 6 * MIB), b"no image"):
        await wire.http.post(f"{at}/frames?maps=true", content=frame, headers={"Content-Type": "image/jpeg"})
    for query in ("", "?format=csv", "?format=mot", "?format=otb&target=0"):
        assert (await wire.http.get(f"{at}/trajectory{query}")).status_code == 200
    packed = await wire.http.get(f"{at}/trajectory", headers={"Accept": "application/msgpack"})
    assert packed.status_code == 200
    snapshot = await wire.http.get(f"{at}/snapshot")
    kind = {"Content-Type": snapshot.headers["content-type"]}
    assert (await wire.http.post("/v1/sessions", content=snapshot.content, headers=kind)).status_code == 201
    assert (await wire.http.post(f"{at}/ticket", json={})).status_code == 201
    assert (await wire.http.post(f"{at}/targets", json={"box": [1, 2, 30, 40]})).status_code == 201
    assert (await wire.http.put(f"{at}/targets/1", json={"box": [1, 2, 30, 40]})).status_code == 200
    assert (await wire.http.delete(f"{at}/targets/1")).status_code == 204
    await asyncio.gather(wire.http.get(at), wire.http.get("/v1/sessions"), wire.http.head("/livez"))
    assert (await wire.http.delete(at)).status_code == 204
