"""`mfcmt trax` with the real VOT toolkit, on sequences that we render."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core import synthetic
from tests.commands import run_command

from .conftest import run

LENGTH = 12
STACK = """\
title: Rendered sequences
experiments:
  longterm:
    type: unsupervised
    repetitions: 1
    analyses:
      - type: pr_curve
"""


def rectangle(x: float, y: float, w: float, h: float) -> str:
    return f"{x:.2f},{y:.2f},{w:.2f},{h:.2f}"


def polygon(x: float, y: float, w: float, h: float) -> str:
    return f"{x},{y},{x + w},{y},{x + w},{y + h},{x},{y + h}"


def mask(x: float, y: float, w: float, h: float) -> str:
    """A mask of ones alone: its offset and size, no zeros, then all ones."""
    left, top, across, down = map(int, (x, y, w, h))
    return f"m{left},{top},{across},{down},0,{across * down}"


REGIONS = {"rectangle": rectangle, "polygon": polygon, "mask": mask}


@pytest.fixture(scope="module")
def workspace(tools: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace of the toolkit with a sequence for each kind of region, as docs/integrations.md has it."""
    folder = tmp_path_factory.mktemp("vot")
    clip = synthetic.clip("motion", size=(160, 120), target=(30, 24), length=LENGTH)
    for name, region in REGIONS.items():
        colors = folder / "sequences" / name / "color"
        colors.mkdir(parents=True)
        for number, frame in enumerate(clip.frames, 1):
            cv2.imwrite(str(colors / f"{number:08}.jpg"), frame)
        truth = "\n".join(region(*map(float, box)) for box in clip.boxes[:LENGTH])
        (colors.parent / "groundtruth.txt").write_text(f"{truth}\n")
        about = f"channels.color=color/%08d.jpg\nfps=30\nformat=default\nname={name}\nwidth=160\nheight=120\n"
        (colors.parent / "sequence").write_text(about)
    (folder / "sequences" / "list.txt").write_text("\n".join(REGIONS) + "\n")
    (folder / "trackers.ini").write_text(f"[MFCMT]\nlabel = MFCMT\nprotocol = trax\ncommand = {tools}/mfcmt trax\n")
    (folder / "config.yaml").write_text("registry:\n- ./trackers.ini\nstack: stack.yaml\n")
    (folder / "stack.yaml").write_text(STACK)
    warm = run([tools / "mfcmt", "warmup"])
    assert warm.returncode == 0, warm.stderr
    return folder


def test_the_toolkit_accepts_the_tracker(tools: Path, workspace: Path) -> None:
    """It has several objects in each frame of its own sequence."""
    done = run([tools / "vot", "--registry", workspace / "trackers.ini", "test", "MFCMT"], cwd=workspace)
    assert "Test concluded successfuly" in done.stdout + done.stderr
    assert done.returncode == 0


def test_the_toolkit_evaluates_rectangles_polygons_and_masks_with_confidence(tools: Path, workspace: Path) -> None:
    done = run([tools / "vot", "evaluate", "--workspace", workspace, "MFCMT"], cwd=workspace)
    assert "Evaluation concluded successfuly" in done.stdout + done.stderr, done.stdout + done.stderr
    for name in REGIONS:
        results = workspace / "results" / "MFCMT" / "longterm" / name
        assert (results / f"{name}_001.bin").stat().st_size > 0
        lines = (results / f"{name}_001_confidence.value").read_text().splitlines()
        confidences = np.array([float(line or "nan") for line in lines])
        assert len(confidences) == LENGTH
        assert (confidences[1:] > 0.5).all()


def begin(image: Path, region: str) -> str:
    """What a client of TraX 4 writes to start on an object."""
    return f'@@TRAX:initialize "{region}"\n@@TRAX:frame "file://{image}"\n'


@pytest.mark.parametrize("sent", ["nonsense\n@@TRAX:nonsense\n", ""])
def test_what_is_not_traxs_ends_with_a_word(tools: Path, sent: str) -> None:
    done = run([tools / "mfcmt", "trax"], input=sent)
    assert (done.returncode, "Traceback" in done.stderr) == (1, False)
    assert done.stderr.startswith("mfcmt trax: ")


def test_a_frame_that_cannot_be_read_ends_with_a_word(tools: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.jpg").write_bytes(b"no image")
    done = run([tools / "mfcmt", "trax"], input=begin(tmp_path / "bad.jpg", "10,10,20,20"))
    assert done.returncode == 1
    assert "bad.jpg" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_box_without_a_place_in_the_frame_ends_with_a_word(tools: Path, workspace: Path) -> None:
    image = workspace / "sequences" / "mask" / "color" / "00000001.jpg"
    done = run([tools / "mfcmt", "trax"], input=begin(image, "900,900,20,20"))
    assert (done.returncode, "Traceback" in done.stderr) == (1, False)
    assert "quarter" in done.stderr


def test_the_command_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trax", None)
    done = run_command("trax")
    assert done.returncode == 2
    assert "pip install vot-trax" in done.stderr
