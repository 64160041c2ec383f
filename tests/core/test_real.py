"""A few short real sequences hold their mean overlap; the bounds leave room for another tuning."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mfcmt_core import MFCMT
from mfcmt_core.otb.metrics import overlap

from .helpers import PRESETS, assert_sane, boxes_of


def load(root, name, length):
    """Return the frames and the true boxes, 0-based."""
    folder = root / name
    lines = (folder / "groundtruth_rect.txt").read_text().replace(",", " ").splitlines()
    truth = np.array([line.split() for line in lines[:length]], float) - (1, 1, 0, 0)
    return [cv2.imread(str(file)) for file in sorted((folder / "img").iterdir())[:length]], truth


@pytest.mark.parametrize(
    ("name", "length", "default", "paper"),
    [
        ("Deer", 71, 0.6, 0.6),
        ("Crossing", 120, 0.65, 0.6),
        ("Man", 134, 0.7, 0.7),
        ("MountainBike", 60, 0.65, 0.6),
        ("CarDark", 60, 0.7, 0.7),
        ("Girl", 60, 0.7, 0.65),
        ("Car1", 60, 0.8, 0.8),
    ],
)
def test_real_sequences_are_tracked_with_their_known_overlap(otb_root, name, length, default, paper):
    frames, truth = load(otb_root, name, length)
    assert len(frames) == len(truth) == length
    for preset, bound in (("default", default), ("paper", paper)):
        results = list(MFCMT(PRESETS[preset]).track(frames, truth[0]))
        for result in results:
            assert_sane(result, frames[0].shape[1::-1])
        assert overlap(boxes_of(results), truth).mean() > bound


def test_gray_sequences_are_recognized(otb_root):
    """They are stored with three equal channels; Man only looks gray."""
    for name, gray in (("Car1", True), ("Jumping", True), ("Man", False), ("MountainBike", False)):
        frames, truth = load(otb_root, name, 2)
        tracker = MFCMT()
        tracker.init(frames[0], truth[0])
        single = MFCMT()
        single.init(cv2.cvtColor(frames[0], cv2.COLOR_BGR2GRAY), truth[0])
        assert (len(tracker.to_bytes()) == len(single.to_bytes())) == gray
