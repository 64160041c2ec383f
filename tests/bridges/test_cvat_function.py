"""CVAT's agents: the real cvat-cli runs our function against a stand-in for CVAT's server."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import cv2
import pytest

from mfcmt_core import MFCMT
from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip, encode

from .conftest import run
from .fake_cvat import FakeCvat

MODULE = "service.bridges.cvat_function"


def agent(tools: Path, fake: FakeCvat, *words: str) -> subprocess.CompletedProcess[str]:
    """Run cvat-cli against the stand-in; a run-agent ends when the queue is empty."""
    return run(
        [tools / "cvat-cli", "--server-host", fake.url, "function", *words, "--function-module", MODULE],
        env={"CVAT_ACCESS_TOKEN": "a-token"},
    )


def rectangle(box: Any) -> dict[str, Any]:
    x, y, w, h = box
    return {"type": "rectangle", "points": [float(v) for v in (x, y, x + w, y + h)]}


def begin(shape: Any, task: int = 1, frame: int = 0) -> dict[str, Any]:
    return {"type": "init_tracking", "task": task, "frame": frame, "shapes": [shape]}


def go_on(frame: int, *states: str, task: int = 1) -> dict[str, Any]:
    return {"type": "track", "task": task, "frame": frame, "states": list(states)}


@pytest.fixture
def frames(clip: Clip) -> tuple[list[bytes], list[tuple[int, int]]]:
    """Four frames of a clip, and one of another size."""
    image, _ = decode(clip.frames[4], LIMITS)
    half = cv2.resize(image, None, fx=0.5, fy=0.5)
    return [*clip.frames[:4], encode(half)], [clip.size] * 4 + [(half.shape[1], half.shape[0])]


def test_an_agent_tracks_as_the_library_does(tools: Path, frames: Any, clip: Clip) -> None:
    shape = rectangle(clip.box)
    with FakeCvat(*frames, [begin(shape), *(go_on(n, "@0") for n in (1, 2, 3))]) as fake:
        done = agent(tools, fake, "run-agent", "1", "--burst")
    assert done.returncode == 0, done.stderr
    assert fake.failed == {}
    images = [decode(frame, LIMITS)[0] for frame in clip.frames[:4]]
    for number, result in enumerate(MFCMT().track(images, clip.box)):
        if number:
            (found,) = fake.completed[number]["shapes"]
            assert found["points"] == pytest.approx(rectangle(result.box)["points"], abs=0.5)  # PIL's JPEG decoder
            assert fake.completed[number]["states"] == fake.states


def test_a_function_is_registered(tools: Path, frames: Any) -> None:
    with FakeCvat(*frames, []) as fake:
        done = agent(tools, fake, "create-native", "MFCMT", "-p", "preset=str:paper")
    assert done.returncode == 0, done.stderr
    (created,) = fake.created
    assert (created["kind"], created["supported_shape_types"]) == ("tracker", ["rectangle"])


def test_states_are_bound_to_their_task_and_image_size(tools: Path, frames: Any, clip: Clip) -> None:
    shape = rectangle(clip.box)
    queue = [begin(shape), go_on(1, "@0", task=2), go_on(4, "@0"), go_on(1, "unknown"), go_on(1, "@0")]
    with FakeCvat(*frames, queue) as fake:
        done = agent(tools, fake, "run-agent", "1", "--burst")
    assert done.returncode == 0, done.stderr
    assert set(fake.failed) == {1, 2, 3}
    assert "is not for task #2" in fake.failed[1]
    assert "sizes" in fake.failed[2]
    assert "not found" in fake.failed[3]
    assert fake.completed[4]["shapes"][0]["type"] == "rectangle"


def test_the_states_used_last_are_kept(tools: Path, frames: Any, clip: Clip) -> None:
    shape = rectangle(clip.box)
    queue = [begin(shape), begin(shape), go_on(1, "@0"), begin(shape), go_on(2, "@0"), go_on(1, "@1"), go_on(1, "@2")]
    with FakeCvat(*frames, queue) as fake:
        done = agent(tools, fake, "run-agent", "1", "--burst", "-p", "max_states=int:2")
    assert done.returncode == 0, done.stderr
    assert set(fake.failed) == {5}
    assert {4, 6} <= set(fake.completed)


# The agent's process, with a clock of its own.
TWO_PICTURES = """
import time
from types import SimpleNamespace
now = 0.0
time.monotonic = lambda: now
import numpy as np
from service.bridges.cvat_function import KEEP_S, StateDropped, create
picture = np.random.default_rng(1).integers(0, 255, (120, 160, 3), np.uint8)
shape = SimpleNamespace(type="rectangle", points=[60, 40, 100, 80])
context = SimpleNamespace(original_shape_type="rectangle")
function = create()
state = function.init_tracking_state(context, picture, shape)
now = KEEP_S - 1
assert function.track(context, picture, state).type == "rectangle"
now += KEEP_S - 1  # counted from its last use
assert function.track(context, picture, state).type == "rectangle"
now += KEEP_S + 1
try:
    function.track(context, picture, state)
except StateDropped:
    print("dropped after", KEEP_S / 3600, "hours")
"""


def test_a_state_is_dropped_eight_hours_after_its_last_use(tools: Path) -> None:
    done = run([tools / "python", "-c", TWO_PICTURES])
    assert done.returncode == 0, done.stderr
    assert done.stdout == "dropped after 8.0 hours\n"


def test_a_bad_preset_is_told(tools: Path, frames: Any) -> None:
    with FakeCvat(*frames, []) as fake:
        done = agent(tools, fake, "run-agent", "1", "--burst", "-p", "preset=str:best")
    assert done.returncode != 0
    assert "best" in done.stderr
