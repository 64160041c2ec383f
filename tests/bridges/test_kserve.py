"""KServe v2: the real tritonclient, and the bare wire where that client cannot err."""

from __future__ import annotations

import asyncio
import json
import struct
from pathlib import Path
from typing import Any

import httpx2
import pytest

from mfcmt_core import MFCMT, MFCMTConfig
from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip
from service.load.own import OwnServer

from .conftest import KEY, OTHER, script

INFER = "/v2/models/mfcmt/infer"
FRAMES = 6


@pytest.fixture(scope="module")
def said(tools: Path, bridged: OwnServer, clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the real client got."""
    folder = tmp_path_factory.mktemp("frames")
    for number, frame in enumerate(clip.frames[:FRAMES]):
        (folder / f"{number}.jpg").write_bytes(frame)
    box = ",".join(map(str, clip.box))
    said: dict[str, Any] = script(
        tools, Path(__file__).parent / "triton_client.py", bridged.url.removeprefix("http://"), KEY, folder, box
    )
    return said


@pytest.fixture
async def http(bridged: OwnServer) -> Any:
    async with httpx2.AsyncClient(base_url=bridged.url, headers={"X-API-Key": KEY}, timeout=60) as client:
        yield client


def library(clip: Clip, config: MFCMTConfig | None = None) -> list[Any]:
    """What the library says of the frames."""
    images = [decode(frame, LIMITS)[0] for frame in clip.frames[:FRAMES]]
    return list(MFCMT(config).track(images, clip.box))


def request(clip: Clip, frame: int = 0, *, box: bool = False, **parameters: Any) -> dict[str, Any]:
    """A request with a binary frame, as a client sends it."""
    data = clip.frames[frame]
    inputs: list[dict[str, Any]] = [
        {"name": "FRAME", "datatype": "UINT8", "shape": [len(data)], "parameters": {"binary_data_size": len(data)}}
    ]
    if box:
        inputs.append({"name": "BOX", "datatype": "FP32", "shape": [4], "data": list(clip.box)})
    head = json.dumps({"inputs": inputs, "parameters": parameters}).encode()
    return {"content": head + data, "headers": {"Inference-Header-Content-Length": str(len(head))}}


def test_the_client_finds_server_and_model(said: dict[str, Any]) -> None:
    assert (said["live"], said["ready"], said["model_ready"]) == (True, True, True)
    assert {"sequence", "sequence(string_id)", "binary_tensor_data"} <= set(said["server"]["extensions"])
    assert [tensor["name"] for tensor in said["model"]["inputs"]] == ["FRAME", "BOX"]
    assert [tensor["name"] for tensor in said["model"]["outputs"]] == ["BOX", "CONFIDENCE", "STATUS"]


@pytest.mark.parametrize("name", ["int", "string", "paper"])
def test_a_sequence_gives_the_results_of_the_library(said: dict[str, Any], clip: Clip, name: str) -> None:
    truth = library(clip, MFCMTConfig.paper() if name == "paper" else None)
    assert len(said[name]) == FRAMES
    for found, result in zip(said[name], truth, strict=True):
        assert found["box"] == [pytest.approx(result.box, rel=1e-6)]
        assert found["confidence"] == pytest.approx([result.confidence], rel=1e-6)
        assert found["status"] == [result.status]


def test_raw_pixels_and_json_tensors_are_frames_too(said: dict[str, Any], clip: Clip) -> None:
    x, y, *_ = said["pixels"][-1]["box"][0]
    assert (x, y) == pytest.approx(library(clip)[-1].box[:2], abs=2)
    assert said["json"]["status"] == ["tracking"]
    assert said["json"]["box"][0] == pytest.approx([value / 4 for value in clip.box])


def test_a_sequence_can_have_several_targets_and_start_again(said: dict[str, Any]) -> None:
    assert (len(said["two"]["box"]), len(said["two"]["status"])) == (2, 2)
    assert said["again"] == [1, 2]


@pytest.mark.parametrize(
    ("case", "status", "words"),
    [
        ("no start", "400", "sequence 99 to model 'mfcmt' must specify the START flag"),
        ("no start after the end", "410", "the session ended: closed"),
        ("no sequence", "400", "sequence_id is"),
        ("no box", "400", "BOX is missing"),
        ("no frame", "400", "FRAME is missing"),
        ("no image", "415", "not a JPEG"),
        ("truncated image", "422", "image"),
        ("bad box", "422", "no area"),
        ("batch", "400", "one frame"),
        ("unknown option", "400", "colour"),
        ("unknown output", "400", "no output 'MASK'"),
        ("unknown model", "404", "no such model"),
        ("no key", "401", "no key was shown"),
        ("compressed", "415", "not compressed"),
    ],
)
def test_a_refusal_reaches_the_client(said: dict[str, Any], case: str, status: str, words: str) -> None:
    got, message = said["refused"][case]
    assert str(got) == status
    assert words in message


def test_nothing_but_ready_probes_is_open_without_a_key(bridged: OwnServer) -> None:
    for path in ("/v2", "/v2/models/mfcmt", "/v2/models/mfcmt/ready", "/v2/models/other/versions/2"):
        answer = httpx2.get(bridged.url + path)
        assert (answer.status_code, answer.json()["error"]) == (401, answer.json()["detail"])
    assert httpx2.get(f"{bridged.url}/v2/health/live").json() == {"live": True}
    assert httpx2.post(f"{bridged.url}/v2/models/mfcmt", headers={"X-API-Key": KEY}).headers["Allow"] == "GET, HEAD"


def test_without_the_setting_there_is_no_interface(own_server: Any) -> None:
    server = own_server()
    for path in ("/v2", "/v2/models/mfcmt", "/api/functions", "/labelstudio/health"):
        assert httpx2.get(server.url + path).status_code == 404


async def test_another_keys_sequence_is_as_one_that_never_began(http: httpx2.AsyncClient, clip: Clip) -> None:
    begun = await http.post(INFER, **request(clip, box=True, sequence_id="mine", sequence_start=True))
    assert begun.status_code == 200, begun.text
    sent = request(clip, 1, sequence_id="mine")
    sent["headers"] |= {"X-API-Key": OTHER}
    answer = await http.post(INFER, **sent)
    assert (answer.status_code, answer.json()["code"]) == (400, "bad-request")
    assert (await http.post(INFER, **request(clip, 1, sequence_id="mine", sequence_end=True))).status_code == 200


async def test_malformed_requests_are_told(http: httpx2.AsyncClient, clip: Clip) -> None:
    def tensor(**changes: Any) -> bytes:
        frame = {"name": "FRAME", "datatype": "UINT8", "shape": [3], "data": [255, 216, 255]} | changes
        return json.dumps({"inputs": [frame], "parameters": {"sequence_id": 1, "sequence_start": True}}).encode()

    bodies = [
        b"",
        b"{",
        b"[]",
        b'{"inputs":{}}',
        b'{"inputs":[1]}',
        b'{"inputs":[{"name":"FRAME"}]}',
        tensor(shape=[2]),
        tensor(shape=[-3]),
        tensor(shape=[3, 1, 1, 1, 1]),
        tensor(datatype="FP64"),
        tensor(data=[255, 216, 256]),
        tensor(data=[255, [216], 255]),
        tensor(data="text"),
        tensor(data=None, parameters={"binary_data_size": 3}),
        tensor(parameters={"binary_data_size": -1}),
        tensor(parameters=[]),
        tensor(datatype="BYTES", shape=[1], data=["not base64"]),
        tensor(name="OTHER"),
        json.dumps({"inputs": [], "parameters": {"sequence_id": 1}, "id": 5}).encode(),
        json.dumps({"inputs": [{"name": "FRAME", "datatype": "UINT8", "shape": [0], "data": []}] * 2}).encode(),
    ]
    for body in bodies:
        answer = await http.post(INFER, content=body)
        assert (answer.status_code, answer.json()["code"]) == (400, "bad-request"), (body, answer.text)
        assert answer.json()["error"] == answer.json()["detail"]
    for length in ("9999999", "x", "-1"):
        answer = await http.post(INFER, content=tensor(), headers={"Inference-Header-Content-Length": length})
        assert answer.status_code == 400, length
    for element in (b"", struct.pack("<I", 5) + b"abc"):
        frame = {"name": "FRAME", "datatype": "BYTES", "shape": [1], "parameters": {"binary_data_size": len(element)}}
        head = json.dumps({"inputs": [frame]}).encode()
        sent = {"Inference-Header-Content-Length": str(len(head))}
        assert (await http.post(INFER, content=head + element, headers=sent)).status_code == 400
    for parameters in ({"sequence_id": -1}, {"sequence_id": "a b"}, {"sequence_id": "x" * 129}, {"sequence_id": True}):
        answer = await http.post(INFER, **request(clip, box=True, sequence_start=True, **parameters))
        assert answer.status_code == 400, parameters
    answer = await http.post(INFER, **request(clip, box=True, sequence_id=1, sequence_start="yes"))
    assert (answer.status_code, "sequence_start" in answer.json()["detail"]) == (400, True)


async def test_limits_of_frames_hold(http: httpx2.AsyncClient, clip: Clip) -> None:
    large = json.dumps({"inputs": [], "note": "x" * 70_000}).encode()
    assert (await http.post(INFER, content=large)).json()["code"] == "body-too-large"
    padded = bytes(9 << 20)
    assert (await http.post(INFER, content=padded)).json()["code"] == "frame-too-large"


async def test_an_idle_sequence_expires_and_says_so(http: httpx2.AsyncClient, clip: Clip) -> None:
    begun = request(clip, box=True, sequence_id="idle", sequence_start=True, idle_timeout_s=1.0)
    assert (await http.post(INFER, **begun)).status_code == 200
    await asyncio.sleep(2)
    answer = await http.post(INFER, **request(clip, 1, sequence_id="idle"))
    assert (answer.status_code, answer.json()["reason"]) == (410, "idle")
    assert (
        await http.post(INFER, **request(clip, box=True, sequence_id="idle", sequence_start=True))
    ).status_code == 200


async def test_sequences_outlive_a_restart_and_a_full_service_takes_a_new_start(
    own_server: Any, clip: Clip, tmp_path: Path
) -> None:
    server = own_server(bridges="kserve", state_dir=tmp_path, max_sessions_per_lane=1)
    async with httpx2.AsyncClient(base_url=server.url, timeout=60) as http:
        start = request(clip, box=True, sequence_id="cam", sequence_start=True)
        assert (await http.post(INFER, **start)).status_code == 200
        server.stop()
        server.start()
        assert (await http.post(INFER, **request(clip, 1, sequence_id="cam"))).status_code == 200
        other = await http.post(INFER, **request(clip, box=True, sequence_id="other", sequence_start=True))
        assert (other.status_code, "Retry-After" in other.headers) == (503, True)
        assert (await http.post(INFER, **start)).status_code == 200
        assert len((await http.get("/v1/sessions")).json()["sessions"]) == 1


async def test_frames_of_sequences_are_counted(http: httpx2.AsyncClient, clip: Clip) -> None:
    def counted(text: str) -> float:
        lines = text.splitlines()
        return sum(float(line.split()[-1]) for line in lines if line.startswith("mfcmt_target_results_total"))

    before = counted((await http.get("/metrics")).text)
    await http.post(INFER, **request(clip, box=True, sequence_id="counted", sequence_start=True))
    await http.post(INFER, **request(clip, 1, sequence_id="counted", sequence_end=True))
    text = (await http.get("/metrics")).text
    assert counted(text) == before + 1
    assert 'path="/v2/models/{model}/infer"' in text
