"""The examples for other libraries, with the real ones where PyPI has them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core import synthetic
from mfcmt_core.adapters import OpenCVTracker
from mfcmt_core.video.write import VideoWriter
from tests.conftest import ROOT

from .conftest import run

EXAMPLES = ROOT / "docs" / "examples"


def test_the_supervision_example_keeps_a_box_between_detections(tools: Path, tmp_path: Path) -> None:
    writer = VideoWriter(tmp_path / "clip.mp4", 25)
    for number, frame in enumerate(synthetic.clip("motion", size=(160, 120), target=(30, 24), length=25).frames):
        writer.write(frame, number / 25)
    writer.close()
    done = run([tools / "python", EXAMPLES / "supervision_between.py", tmp_path / "clip.mp4"])
    assert done.returncode == 0, done.stderr
    rows = [line.split(",") for line in done.stdout.splitlines()]
    assert [int(row[0]) for row in rows] == list(range(25))
    sources = [row[1] for row in rows]
    assert sources[0] == "detector"
    assert sources.count("tracker") > 10


@pytest.mark.parametrize("make", [cv2.TrackerMIL_create, OpenCVTracker.create])  # type: ignore[attr-defined]
def test_code_for_a_tracker_of_opencv_changes_one_line(make: object) -> None:
    """The loop of docs/integrations.md, with one of OpenCV's own trackers and with ours."""
    clip = synthetic.clip("motion", size=(160, 120), target=(30, 24), length=8)
    tracker = make()  # type: ignore[operator]
    tracker.init(clip.frames[0], tuple(map(int, clip.boxes[0])))
    for number in range(1, 8):
        ok, box = tracker.update(clip.frames[number])
        assert ok
        assert np.abs(np.subtract(box, clip.boxes[number])).max() < 12


def test_the_drop_in_has_the_score_of_newer_trackers() -> None:
    clip = synthetic.clip("motion", size=(160, 120), target=(30, 24), length=3)
    tracker = OpenCVTracker.create()
    assert tracker.getTrackingScore() == 0
    tracker.init(clip.frames[0], clip.boxes[0])
    tracker.update(clip.frames[1])
    assert 0.5 < tracker.getTrackingScore() <= 1
    assert {"init", "update", "getTrackingScore"} <= set(dir(cv2.TrackerNano))  # type: ignore[attr-defined]
