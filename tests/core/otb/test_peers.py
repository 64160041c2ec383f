"""Adapters of other libraries' trackers."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mfcmt_core.otb import open_otb, score
from mfcmt_core.otb.peers import DlibPeer, OpenCVPeer, Peer
from tests.conftest import ROOT, require

FRAME = np.zeros((48, 64, 3), np.uint8)


class Scripted:
    """Stands in for a tracker of OpenCV: whole pixels only, and (0, 0, 0, 0) on a miss."""

    def __init__(self, answers: list[tuple[bool, tuple[int, int, int, int]]]) -> None:
        self.answers = answers
        self.begun: Any = None

    def init(self, image: Any, box: tuple[int, int, int, int]) -> None:
        assert all(isinstance(v, int) for v in box)
        self.begun = box

    def update(self, image: Any) -> tuple[bool, tuple[int, int, int, int]]:
        return self.answers.pop(0)


def test_a_miss_keeps_the_box_before() -> None:
    inner = Scripted([(True, (5, 6, 7, 8)), (False, (0, 0, 0, 0)), (True, (6, 6, 7, 8))])
    tracker = OpenCVPeer(lambda: inner)
    tracker.init(FRAME, (1.4, 2.6, 7.0, 8.0))
    assert inner.begun == (1, 3, 7, 8)
    assert [tracker.update(FRAME) for _ in range(3)] == [(5, 6, 7, 8), (5, 6, 7, 8), (6, 6, 7, 8)]


def test_a_real_tracker_of_opencv_follows_its_target(otb_root: Path) -> None:
    """MIL is the one that every wheel of OpenCV has."""
    crossing = open_otb(otb_root)["Crossing"]
    tracker = OpenCVPeer(cv2.TrackerMIL_create)  # type: ignore[attr-defined]
    tracker.init(crossing.read(0), crossing.boxes[0])
    boxes = [tracker.update(crossing.read(i)) for i in range(1, 12)]
    errors = np.linalg.norm(np.array(boxes)[:, :2] - crossing.boxes[1:12, :2], axis=1)
    assert errors.max() < 20


def test_the_tracker_of_dlib_follows_its_target(otb_root: Path) -> None:
    require(importlib.util.find_spec("dlib"), "needs dlib (pip install dlib-bin)")
    crossing = open_otb(otb_root)["Crossing"]
    tracker = DlibPeer()
    tracker.init(crossing.read(0), crossing.boxes[0])
    boxes = [crossing.boxes[0], *(tracker.update(crossing.read(i)) for i in range(1, len(crossing)))]
    assert score(open_otb(otb_root).select(["Crossing"]), {"Crossing": boxes}).precision > 0.9
    assert Peer("dlib", "dlib").lacks is None
    assert Peer("dlib", "dlib").identity["code"].startswith("dlib ")


def test_nanotrack_needs_its_two_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MFCMT_NANOTRACK", str(tmp_path))
    assert "MFCMT_NANOTRACK" in (Peer("nano", "opencv-nano").lacks or "")


def test_nanotrack_follows_a_pedestrian(otb_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = otb_root.parent / "peers" / "nanotrackv2"
    require(folder.is_dir(), f"no files of NanoTrack at {folder}")
    monkeypatch.setenv("MFCMT_NANOTRACK", str(folder))
    crossing = open_otb(otb_root)["Crossing"]
    assert Peer("nano", "opencv-nano").lacks is None
    tracker = Peer("nano", "opencv-nano").make()
    tracker.init(crossing.read(0), crossing.boxes[0])
    boxes = [tracker.update(crossing.read(i)) for i in range(1, 12)]
    assert np.linalg.norm(np.array(boxes)[:, :2] - crossing.boxes[1:12, :2], axis=1).max() < 20
    assert 0 <= tracker.confidence <= 1


TWO_FRAMES = """
import json, sys
from pathlib import Path
from mfcmt_core.otb import open_otb
from mfcmt_core.otb.peers import Peer
name, crossing = sys.argv[1], open_otb(Path(sys.argv[2]))["Crossing"]
tracker = Peer(name, name).make()
tracker.init(crossing.read(0), crossing.boxes[0])
print(json.dumps([float(v) for v in tracker.update(crossing.read(1))]))
"""


@pytest.mark.parametrize("name", ["opencv-csrt", "opencv-kcf", "opencv-mosse"])
def test_trackers_of_opencv_contrib_run_in_their_own_environment(name: str, otb_root: Path) -> None:
    """In the environment of their own, for their wheel replaces the one that the project uses."""
    python = ROOT / ".venv-peers" / "bin" / "python"
    require(python.exists(), f"{Peer(name, name).lacks} is not installed (make peers)")
    command = [python, "-c", TWO_FRAMES, name, otb_root]
    box = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert np.abs(np.array(box) - open_otb(otb_root)["Crossing"].boxes[1]).max() < 8
