"""CVAT's serverless functions: the vectors of the contract, sent as CVAT sends them (with requests)."""

from __future__ import annotations

import base64
import json
from typing import Any

import cv2
import httpx2
import numpy as np
import pytest

from mfcmt_core import MFCMT
from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip, encode
from service.load.own import OwnServer

from .conftest import KEY, OTHER

requests = pytest.importorskip("requests")
HEADERS = {
    "x-nuclio-project-name": "cvat",
    "x-nuclio-function-namespace": "nuclio",
    "x-nuclio-invoke-via": "domain-name",
    "X-Nuclio-Invoke-Timeout": "120s",
}


class Gateway:
    """Calls a Nuclio dashboard with the key in its URL, as CVAT does that has it in CVAT_NUCLIO_HOST."""

    def __init__(self, server: OwnServer, key: str = KEY) -> None:
        self.root = f"http://cvat:{key}@127.0.0.1:{server.port}"

    def get(self, path: str) -> Any:
        return requests.get(self.root + path, headers=HEADERS, timeout=60)

    def invoke(self, image: bytes | str, shapes: list[Any], states: list[Any], **more: Any) -> Any:
        text = image if isinstance(image, str) else base64.b64encode(image).decode()
        headers = HEADERS | {"x-nuclio-function-name": "mfcmt", "x-nuclio-path": "/"}
        document = {"image": text, "shapes": shapes, "states": states, **more}
        return requests.post(f"{self.root}/api/function_invocations", json=document, headers=headers, timeout=120)


@pytest.fixture(scope="module")
def cvat(bridged: OwnServer) -> Gateway:
    return Gateway(bridged)


def corners(box: Any) -> list[float]:
    x, y, w, h = box
    return [x, y, x + w, y + h]


def good(answer: Any) -> tuple[list[Any], list[Any]]:
    assert answer.status_code == 200, answer.text
    document = answer.json()
    assert document.keys() == {"shapes", "states"}
    assert len(document["shapes"]) == len(document["states"])
    return document["shapes"], document["states"]


def refused(answer: Any, status: int = 400) -> str:
    """The detail of a refusal, which is a problem and never a trace."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    detail: str = answer.json()["detail"]
    assert "Traceback" not in detail
    return detail


def test_cvat_lists_one_tracker_of_rectangles(cvat: Gateway) -> None:
    listed = cvat.get("/api/functions").json()
    (about,) = listed.values()
    assert (about["metadata"]["name"], about["metadata"]["annotations"]["type"]) == ("mfcmt", "tracker")
    assert about["metadata"]["annotations"]["supported_shape_types"].split(",") == ["rectangle"]
    assert about["status"]["state"] == "ready"
    assert cvat.get("/api/functions/mfcmt").json() == about
    assert cvat.get("/api/functions/other").status_code == 404


def test_a_track_gives_the_boxes_of_the_library(cvat: Gateway, clip: Clip) -> None:
    """N1 and N2, as older versions of CVAT send shapes and as newer ones do."""
    images = [decode(frame, LIMITS)[0] for frame in clip.frames[:5]]
    truth = [corners(result.box) for result in MFCMT().track(images, clip.box)]
    begin = corners(clip.box)
    for shape in (begin, {"type": "rectangle", "points": begin}):
        shapes, states = good(cvat.invoke(clip.frames[0], [shape], []))
        assert shapes == [shape]
        assert states[0]
        for frame, box in zip(clip.frames[1:5], truth[1:], strict=True):
            shapes, states = good(cvat.invoke(frame, [None], states))
            points = shapes[0]["points"] if isinstance(shape, dict) else shapes[0]
            assert points == pytest.approx(box)


def test_objects_begin_beside_others_that_go_on(cvat: Gateway, clip: Clip) -> None:
    """N3; what the shape of a known object says is padding."""
    box = corners(clip.box)
    _, states = good(cvat.invoke(clip.frames[0], [box], []))
    shapes, more = good(cvat.invoke(clip.frames[1], [box, box], states))
    assert shapes[1] == box
    assert shapes[0] != box
    shapes, _ = good(cvat.invoke(clip.frames[2], [None, None, box], [more[0], more[1], None]))
    assert len(shapes) == 3
    assert good(cvat.invoke(clip.frames[2], [], [])) == ([], [])  # N4


def test_a_changed_state_is_refused(cvat: Gateway, clip: Clip) -> None:
    """N5, at many places of the state."""
    _, (state,) = good(cvat.invoke(clip.frames[0], [corners(clip.box)], []))
    length = len(state)
    for place in [*range(0, 120, 5), length // 3, length // 2, length - 3, length - 2, length - 1]:
        other = "A" if state[place] != "A" else "B"
        answer = cvat.invoke(clip.frames[1], [None], [state[:place] + other + state[place + 1 :]])
        assert answer.status_code in (400, 422), place
        assert answer.json()["code"] in ("bad-request", "bad-snapshot")
    for odd in ("", "AAAA", state[:-4], state + "AAAA", 7, {"py/object": "os.system"}, [state], "\0" + "0", "\u0100"):
        answer = cvat.invoke(clip.frames[1], [None], [odd])
        assert answer.status_code in (400, 422), odd


def test_a_state_is_of_use_to_its_owner_alone(bridged: OwnServer, cvat: Gateway, clip: Clip) -> None:
    _, states = good(cvat.invoke(clip.frames[0], [corners(clip.box)], []))
    assert "state" in refused(Gateway(bridged, OTHER).invoke(clip.frames[1], [None], states), 422)
    snapshot = base64.b64decode(states[0])
    kind = {"X-API-Key": KEY, "Content-Type": "application/vnd.mfcmt.snapshot"}
    assert requests.post(f"{bridged.url}/v1/sessions", data=snapshot, headers=kind, timeout=60).status_code == 422


def test_a_hundred_objects_on_a_large_frame(cvat: Gateway, clip: Clip) -> None:
    """N6; CVAT gives up after 30 seconds."""
    rng = np.random.default_rng(1)
    image = cv2.resize(rng.integers(0, 255, (270, 480, 3), np.uint8), (3840, 2160))
    frame = encode(image)
    boxes = [
        [30 + 370 * (i % 10), 30 + 210 * (i // 10), 130 + 370 * (i % 10), 110 + 210 * (i // 10)] for i in range(100)
    ]
    shapes, states = good(cvat.invoke(frame, boxes, []))
    assert shapes == boxes
    assert sum(map(len, states)) < 100_000
    shapes, states = good(cvat.invoke(frame, [None] * 100, states))
    errors = [np.abs(np.subtract(shape, box)).max() for shape, box in zip(shapes, boxes, strict=True) if shape]
    assert len(errors) > 90
    assert max(errors) < 4
    shapes, _ = good(cvat.invoke(frame, [None], states[40:41]))
    assert shapes[0] == pytest.approx(boxes[40], abs=4)
    gone = refused(cvat.invoke(frame, [None, [0, 0, 0, 0]], states[:1]), 422)
    assert "no area" in gone


def test_bad_calls_are_told(cvat: Gateway, clip: Clip) -> None:
    """N7, N8 and others."""
    frame, box = clip.frames[0], corners(clip.box)
    polygon = {"type": "polygon", "points": [1, 2, 30, 4, 5, 60]}
    for shape in (polygon, {"type": "rectangle"}, [1, 2, 3], ["1", 2, 3, 4], None, 7, {}):
        assert "rectangle" in refused(cvat.invoke(frame, [shape], []))
    for image in ("no base64!", "AAAA", "", base64.b64encode(b"GIF89a....").decode(), "x" * 5001):
        refused(cvat.invoke(image, [box], []))
    refused(cvat.invoke(frame, [[1e300, 0, -1e300, 9]], []), 422)
    refused(cvat.invoke(frame, [[5000, 5000, 5010, 5010]], []), 422)
    refused(cvat.invoke(frame, [], ["AAAA"]))
    refused(cvat.invoke(frame, [box] * 257, []))
    refused(cvat.invoke(frame, [box], [], threshold="high"))
    refused(cvat.invoke(frame[:-2000], [box], []), 422)
    assert "function" in refused(
        requests.post(
            f"{cvat.root}/api/function_invocations", json={}, headers={"x-nuclio-function-name": "other"}, timeout=60
        ),
        404,
    )
    for body in (b"", b"[]", b"{", b'{"image": "', b'"' * 9999, b"\\" * 9999, b'{"image":"' + b"A" * 9000):
        answer = requests.post(f"{cvat.root}/api/function_invocations", data=body, timeout=60)
        assert answer.status_code == 400, body[:40]
    large = json.dumps({"image": ["x" * 2000] * 40}).encode()
    assert requests.post(f"{cvat.root}/api/function_invocations", data=large, timeout=60).status_code == 400


def test_a_frame_of_another_size_is_refused_and_the_track_goes_on(cvat: Gateway, clip: Clip) -> None:
    """N9."""
    _, states = good(cvat.invoke(clip.frames[0], [corners(clip.box)], []))
    half = encode(cv2.resize(decode(clip.frames[1], LIMITS)[0], None, fx=0.5, fy=0.5))
    assert "expected" in refused(cvat.invoke(half, [None], states))
    good(cvat.invoke(clip.frames[1], [None], states))


def test_an_object_below_the_threshold_is_not_found(cvat: Gateway, clip: Clip) -> None:
    _, states = good(cvat.invoke(clip.frames[0], [corners(clip.box)], []))
    shapes, states = good(cvat.invoke(clip.frames[1], [None], states, threshold=1.01))
    assert shapes == [None]
    shapes, _ = good(cvat.invoke(clip.frames[2], [None], states, threshold=0.0))
    assert shapes[0] is not None


def test_nothing_is_left_of_tracks_whose_states_hold_them(bridged: OwnServer, clip: Clip) -> None:
    other = Gateway(bridged, OTHER)
    _, states = good(other.invoke(clip.frames[0], [corners(clip.box)] * 3, []))
    good(other.invoke(clip.frames[1], [None] * 3, states))
    refused(other.invoke(clip.frames[1], [None, [0, 0, 0, 0]], states[:1]), 422)
    listed = httpx2.get(f"{bridged.url}/v1/sessions", headers={"X-API-Key": OTHER}).json()
    assert listed["sessions"] == []


def test_states_are_read_by_another_replica_with_the_same_signing_key(own_server: Any, clip: Clip) -> None:
    shared = {"bridges": "cvat", "signing_keys": "a-signing-key-of-these-tests"}
    first, second = Gateway(own_server(**shared)), Gateway(own_server(**shared))
    _, states = good(first.invoke(clip.frames[0], [corners(clip.box)], []))
    shapes, _ = good(second.invoke(clip.frames[1], [None], states))
    assert shapes[0] is not None


def test_keys_are_needed(bridged: OwnServer, clip: Clip) -> None:
    for path in ("/api/functions", "/api/functions/mfcmt"):
        assert requests.get(bridged.url + path, timeout=60).status_code == 401
    wrong = Gateway(bridged, "a-key-that-nobody-has")
    assert wrong.invoke(clip.frames[0], [], []).status_code == 401
    assert KEY not in bridged.log


@pytest.fixture(autouse=True)
def _no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
