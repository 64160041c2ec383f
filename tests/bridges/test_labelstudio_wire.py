"""Label Studio's ML backend without its server: which videos are fetched, and what bad calls are told."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx2
import pytest

from mfcmt_core import synthetic
from service.load.own import OwnServer

from .conftest import KEY
from .test_labelstudio import CONFIG, check_follows, clip, region, video

__all__ = ["clip", "video"]
TOKEN = "a-token-of-a-project"


class Host:
    """A web server on a loopback port; ``asked`` are the paths and Authorization headers that came."""

    def __init__(self, files: dict[str, bytes | str]) -> None:
        self.asked: list[tuple[str, str | None]] = []
        host = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                host.asked.append((self.path, self.headers.get("Authorization")))
                found = files.get(self.path)
                self.send_response(302 if isinstance(found, str) else 404 if found is None else 200)
                if isinstance(found, str):
                    self.send_header("Location", found)
                self.end_headers()
                if isinstance(found, bytes):
                    self.wfile.write(found)

            def log_message(self, format: str, *args: Any) -> None:
                return

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.files = files
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture(scope="module")
def hosts(video: Path) -> Iterator[tuple[Host, Host]]:
    """An allowed host and one that is not; both have the video."""
    good, other = (Host({"/clip.mp4": video.read_bytes()}) for _ in range(2))
    good.files |= {
        "/elsewhere": f"http://127.0.0.1:{other.port}/clip.mp4",
        "/moved": "/clip.mp4",
        "/round": "/round",
        "/text": b"no video at all",
        "/cut.mp4": video.read_bytes()[:2000],
        "/large": bytes(300_000),
    }
    yield good, other
    good.stop()
    other.stop()


@pytest.fixture(scope="module")
def backend(hosts: tuple[Host, Host]) -> Iterator[OwnServer]:
    allowed = f"127.0.0.1:{hosts[0].port},videos.example"
    with OwnServer(
        lanes=1,
        bridges="labelstudio",
        api_keys=KEY,
        video_hosts=allowed,
        max_video_bytes=200_000,
        operation_deadline_s=60,
        log_level="debug",
    ) as server:
        yield server


def call(backend: OwnServer, name: str, document: Any) -> httpx2.Response:
    content = document if isinstance(document, bytes) else json.dumps(document).encode()
    url = f"{backend.url}/labelstudio/{name}"
    return httpx2.post(url, content=content, auth=("labelstudio", KEY), timeout=120)


def predict(backend: OwnServer, url: str, *regions: Any, task: Any = None, context: bool = True) -> httpx2.Response:
    tasks = [{"id": 1, "data": {"video": url}} | (task or {})]
    params = {"context": {"result": list(regions)} if context else None}
    document = {"tasks": tasks, "project": "1.2", "label_config": CONFIG, "params": params}
    return call(backend, "predict", document)


def results(answer: httpx2.Response) -> list[dict[str, Any]]:
    assert answer.status_code == 200, answer.text
    (prediction,) = answer.json()["results"]
    found: list[dict[str, Any]] = prediction["result"]
    return found


def test_a_video_of_an_allowed_host_is_tracked(
    backend: OwnServer, hosts: tuple[Host, Host], clip: synthetic.Clip
) -> None:
    base = f"http://127.0.0.1:{hosts[0].port}"
    for path in ("/clip.mp4", "/moved"):
        (found,) = results(predict(backend, base + path, region(clip, 3)))
        check_follows(found, clip, 3)
    early, late = region(clip, 1), region(clip, 9) | {"id": "late"}
    first, second = results(predict(backend, base + "/clip.mp4", early, late))
    check_follows(first, clip, 1)
    check_follows(second, clip, 9)
    assert httpx2.get(f"{backend.url}/v1/sessions", headers={"X-API-Key": KEY}).json()["sessions"] == []


def test_no_other_host_is_asked(backend: OwnServer, hosts: tuple[Host, Host], clip: synthetic.Clip) -> None:
    good, other = hosts
    urls = [
        f"http://127.0.0.1:{other.port}/clip.mp4",
        f"http://127.0.0.1:{good.port}/elsewhere",
        f"http://localhost:{good.port}/clip.mp4",
        f"http://127.0.0.1:{good.port}@127.0.0.1:{other.port}/clip.mp4",
        "http://169.254.169.254/latest/meta-data",
        "file:///etc/passwd",
        "ftp://videos.example/clip.mp4",
        "http://[::1]/clip.mp4",
        "http://videos.example:99999/clip.mp4",
        "//127.0.0.1/clip.mp4",
        "/clip.mp4",
        "concat:/etc/passwd",
    ]
    for url in urls:
        answer = predict(backend, url, region(clip))
        assert (answer.status_code, answer.json()["code"]) == (400, "bad-request"), url
    assert other.asked == []


def test_what_is_no_video_is_told(backend: OwnServer, hosts: tuple[Host, Host], clip: synthetic.Clip) -> None:
    base = f"http://127.0.0.1:{hosts[0].port}"
    for path, status, words in (
        ("/nothing", 400, "404"),
        ("/round", 400, "redirections"),
        ("/text", 400, "not a video"),
        ("/cut.mp4", 400, "not a video"),
        ("/large", 413, "200000 bytes"),
    ):
        answer = predict(backend, base + path, region(clip))
        assert (answer.status_code, words in answer.json()["detail"]) == (status, True), answer.text
        assert "/tmp" not in answer.text


def test_the_token_goes_to_the_projects_own_host_alone(
    backend: OwnServer, hosts: tuple[Host, Host], clip: synthetic.Clip
) -> None:
    good, other = hosts
    setup = {"project": "1.2", "schema": CONFIG, "hostname": f"http://127.0.0.1:{good.port}", "access_token": TOKEN}
    assert call(backend, "setup", setup).json() == {"model_version": "mfcmt"}
    good.asked.clear()
    results(predict(backend, "/clip.mp4", region(clip)))
    assert good.asked == [("/clip.mp4", f"Token {TOKEN}")]
    call(backend, "setup", setup | {"hostname": f"http://127.0.0.1:{other.port}"})
    good.asked.clear()
    results(predict(backend, f"http://127.0.0.1:{good.port}/clip.mp4", region(clip)))
    assert good.asked == [("/clip.mp4", None)]
    assert other.asked == []
    assert TOKEN not in backend.log


def test_a_task_without_a_rectangle_has_an_empty_prediction(backend: OwnServer, clip: synthetic.Clip) -> None:
    assert results(predict(backend, "http://videos.example/clip.mp4", context=False)) == []
    ended = region(clip)
    ended["value"]["sequence"][0]["enabled"] = False
    assert results(predict(backend, "http://videos.example/clip.mp4", ended)) == []
    done = {"annotations": [{"result": [region(clip)]}]}
    assert predict(backend, "http://other.example/x.mp4", task=done, context=False).status_code == 400


def test_bad_calls_are_told(backend: OwnServer, clip: synthetic.Clip) -> None:
    url = "http://videos.example/clip.mp4"
    good = region(clip)
    value = good["value"]
    bad = [
        good | {"id": 5},
        good | {"value": None},
        good | {"value": value | {"framesCount": 0}},
        good | {"value": value | {"duration": 0}},
        good | {"value": value | {"duration": "x"}},
        good | {"value": value | {"sequence": {}}},
        good | {"value": value | {"sequence": [{"frame": 0}]}},
        good | {"value": value | {"sequence": [{"frame": 1, "x": "1"}]}},
        good | {"to_name": "other"},
    ]
    for one in bad:
        answer = predict(backend, url, one)
        assert (answer.status_code, answer.json()["code"]) == (400, "bad-request"), one
    for document in (b"", b"{", b"[]", {}, {"tasks": {}}, {"tasks": [1]}, {"tasks": [], "label_config": 1}):
        assert call(backend, "predict", document).status_code == 400, document
    assert call(backend, "setup", {"project": 1}).status_code == 400
    assert call(backend, "webhook", {"action": "ANNOTATION_CREATED"}).status_code == 201
    assert httpx2.get(f"{backend.url}/labelstudio/health").status_code == 401
