"""Label Studio's ML backend: the real server adds the service, fetches predictions and keeps them."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from mfcmt_core import synthetic
from mfcmt_core.cli import main
from mfcmt_core.exports import labelstudio
from mfcmt_core.video.write import VideoWriter
from service.load.own import OwnServer, free_port

from .conftest import KEY, environment

TOKEN = "0123456789abcdef0123456789abcdef01234567"
LENGTH, FPS = 30, 25
CONFIG = """<View><Labels name="lab" toName="video"><Label value="Car"/></Labels>
<Video name="video" value="$video" framerate="25"/><VideoRectangle name="box" toName="video" smart="true"/></View>"""
START_S = 300.0
SETTINGS = {
    "LABEL_STUDIO_ENABLE_LEGACY_API_TOKEN": "true",
    "ML_BLOCK_LOCAL_IP": "false",
    "SSRF_PROTECTION_ENABLED": "false",
    "USE_DEFAULT_BANNED_SUBNETS": "false",
    "COLLECT_ANALYTICS": "false",
    "LATEST_VERSION_CHECK": "false",
}


@pytest.fixture(scope="module")
def clip() -> synthetic.Clip:
    return synthetic.clip("motion", size=(160, 120), target=(30, 24), length=LENGTH)


@pytest.fixture(scope="module")
def video(clip: synthetic.Clip, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "clip.mp4"
    writer = VideoWriter(path, FPS)
    for number, frame in enumerate(clip.frames):
        writer.write(frame, number / FPS)
    writer.close()
    return path


@pytest.fixture(scope="module")
def studio(tools: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx2.Client]:
    """A client of a Label Studio that has just started."""
    folder, port = tmp_path_factory.mktemp("label-studio"), free_port()
    command = [tools / "label-studio", "start", "--no-browser", "--internal-host", "127.0.0.1", "--port", port]
    command += [
        "--data-dir",
        folder,
        "--username",
        "a@example.com",
        "--password",
        "a-password-1",
        "--user-token",
        TOKEN,
    ]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            list(map(str, command)), env=environment(SETTINGS), stdout=log, stderr=log, cwd=folder
        )
        headers = {"Authorization": f"Token {TOKEN}"}
        try:
            with httpx2.Client(base_url=f"http://127.0.0.1:{port}", headers=headers, timeout=120) as client:
                wait_until_ready(client, process, folder / "log")
                yield client
        finally:
            process.terminate()
            process.wait(60)


def wait_until_ready(client: httpx2.Client, process: subprocess.Popen[bytes], log: Path) -> None:
    give_up = time.monotonic() + START_S
    while time.monotonic() < give_up and process.poll() is None:
        try:
            if client.get("/health").status_code == 200:
                return
        except httpx2.HTTPError:
            pass
        time.sleep(0.5)
    pytest.fail(f"Label Studio did not start: {log.read_text()[-2000:]}")


@pytest.fixture(scope="module")
def backend(studio: httpx2.Client) -> Iterator[OwnServer]:
    with OwnServer(
        lanes=1,
        bridges="labelstudio",
        api_keys=KEY,
        video_hosts="localhost",
        operation_deadline_s=60,
        log_level="debug",
    ) as server:
        yield server


@pytest.fixture(scope="module")
def project(studio: httpx2.Client, backend: OwnServer, video: Path) -> dict[str, Any]:
    """A project with the video as its task, and the service as its backend, with the key as a password."""
    made = good(studio.post("/api/projects", json={"title": "clips", "label_config": CONFIG}))
    with video.open("rb") as file:
        good(studio.post(f"/api/projects/{made['id']}/import", files={"file": ("clip.mp4", file, "video/mp4")}))
    (task,) = good(studio.get("/api/tasks", params={"project": made["id"], "fields": "all"}))["tasks"]
    added = good(
        studio.post(
            "/api/ml",
            json={
                "project": made["id"],
                "url": f"{backend.url}/labelstudio",
                "title": "MFCMT",
                "is_interactive": True,
                "auth_method": "BASIC_AUTH",
                "basic_auth_user": "labelstudio",
                "basic_auth_pass": KEY,
            },
        )
    )
    return {"id": made["id"], "task": task, "backend": added}


def good(answer: httpx2.Response) -> Any:
    assert answer.status_code in (200, 201), (answer.status_code, answer.text[:2000])
    return answer.json()


def region(clip: synthetic.Clip, frame: int = 1, **changes: Any) -> dict[str, Any]:
    """The rectangle that a person has drawn in a frame, from 1."""
    x, y, w, h = clip.boxes[frame - 1]
    keyframe = {
        "frame": frame,
        "x": 100 * x / 160,
        "y": 100 * y / 120,
        "width": 100 * w / 160,
        "height": 100 * h / 120,
        "enabled": True,
        "rotation": 0,
        "time": frame / FPS,
    }
    value = {"framesCount": LENGTH, "duration": LENGTH / FPS, "labels": ["Car"], "sequence": [keyframe]} | changes
    return {"id": "abc", "type": "videorectangle", "from_name": "box", "to_name": "video", "value": value}


def check_follows(result: dict[str, Any], clip: synthetic.Clip, first: int) -> None:
    """The rectangle stays on the target from the frame ``first`` on; between keyframes it moves on lines."""
    sequence = result["value"]["sequence"]
    frames = [one["frame"] for one in sequence]
    assert frames == sorted(set(frames))
    assert (frames[0], frames[-1]) == (first, LENGTH)
    for at in range(first, LENGTH + 1):
        box = [np.interp(at, frames, [one[name] for one in sequence]) for name in ("x", "y", "width", "height")]
        truth = clip.boxes[at - 1] / [1.6, 1.2, 1.6, 1.2]
        assert np.abs(np.array(box) - truth).max() < 5, at
    assert result["value"]["labels"] == ["Car"]
    assert 0.5 < result["meta"]["confidence"] <= 1
    assert "confidence" in result["meta"]["text"][0]
    assert all(0 <= one["score"] <= 1 for one in sequence)


def test_a_drawn_rectangle_is_tracked_through_the_real_server(
    studio: httpx2.Client, project: dict[str, Any], clip: synthetic.Clip, backend: OwnServer
) -> None:
    """The video is an upload: its address is relative to the server, and it needs the server's token."""
    assert project["task"]["data"]["video"].startswith("/data/upload")
    drawn = {"task": project["task"]["id"], "context": {"result": [region(clip, 5)]}}
    answer = good(studio.post(f"/api/ml/{project['backend']['id']}/interactive-annotating", json=drawn))
    assert not answer.get("errors"), answer
    (result,) = answer["data"]["result"]
    assert (result["id"], result["from_name"], result["type"]) == ("abc", "box", "videorectangle")
    check_follows(result, clip, 5)
    assert TOKEN not in backend.log
    assert KEY not in backend.log


def test_the_real_server_keeps_a_prediction_of_what_was_annotated(
    studio: httpx2.Client, project: dict[str, Any], clip: synthetic.Clip
) -> None:
    task = project["task"]["id"]
    good(studio.post(f"/api/tasks/{task}/annotations", json={"result": [region(clip, 1)], "lead_time": 1}))
    params = {"id": "retrieve_tasks_predictions", "project": project["id"]}
    selected = {"selectedItems": {"all": True, "excluded": []}}
    good(studio.post("/api/dm/actions", params=params, json=selected))
    kept = good(studio.get("/api/predictions", params={"task": task}))
    (result,) = kept[-1]["result"]
    check_follows(result, clip, 1)
    assert 0.5 < kept[-1]["score"] <= 1


def test_the_real_server_imports_what_mfcmt_track_exports(
    studio: httpx2.Client, clip: synthetic.Clip, video: Path, tmp_path: Path
) -> None:
    """The task with its path, under the labelling interface that docs/video.md names."""
    box, out = ",".join(map(str, clip.boxes[0])), tmp_path / "task.json"
    command = ["track", str(video), "--box", box, "--class", "Car", "--format", "labelstudio", "--output", str(out)]
    assert main(command) == 0
    (task,) = json.loads(out.read_text())
    task["data"]["video"] = "/data/upload/clip.mp4"
    interface = labelstudio.CONFIG.format(fps=FPS, labels='<Label value="Car"/>')
    made = good(studio.post("/api/projects", json={"title": "export", "label_config": interface}))
    good(studio.post(f"/api/projects/{made['id']}/import", json=[task]))
    (kept,) = good(studio.get("/api/tasks", params={"project": made["id"], "fields": "all"}))["tasks"]
    (prediction,) = good(studio.get("/api/predictions", params={"task": kept["id"]}))
    assert prediction["result"] == task["predictions"][0]["result"]
    assert prediction["result"][0]["value"]["sequence"][-1]["frame"] == LENGTH
