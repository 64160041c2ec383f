"""A target that jumps out of its window: doubts, other places, and the part of the frame that they need."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core import MFCMT, MFCMTConfig, synthetic
from mfcmt_core.otb.dataset import open_otb
from mfcmt_core.otb.metrics import overlap
from mfcmt_core.redetection import other_peaks
from mfcmt_core.tracker import ATTENTION, WIDE_ATTENTION

from .helpers import boxes_of
from .test_regions import compare

DEFAULT = MFCMTConfig.default()
STEADY = 20
"""Frames before the jump: the slow means need ten."""


@pytest.fixture(scope="module")
def clip():
    return synthetic.clip("motion")


def jumped(clip, windows: float):
    """Frames and boxes whose picture moves to the right by so many windows after the steady ones."""
    _, _, w, h = clip.boxes[STEADY]
    shift = round(windows * (w + 0.75 * (w + h)))
    frames = [f if i < STEADY else np.roll(f, shift, 1) for i, f in enumerate(clip.frames)]
    boxes = [b if i < STEADY else (b[0] + shift, *b[1:]) for i, b in enumerate(clip.boxes)]
    return frames, boxes


def iou(a, b):
    return float(overlap(np.array([a]), np.array([b]))[0])


def follow(config, frames, boxes, count):
    tracker = MFCMT(config)
    tracker.init(frames[0], boxes[0])
    return tracker, [tracker.update(frame) for frame in frames[1:count]]


@pytest.mark.parametrize("windows", [0.6, -0.65])
def test_a_jump_beyond_the_window_is_followed_within_three_frames(clip, windows):
    frames, boxes = jumped(clip, windows)
    _, results = follow(DEFAULT, frames, boxes, STEADY + 4)
    assert iou(results[STEADY - 2].box, boxes[STEADY - 1]) > 0.7
    assert iou(results[-1].box, boxes[STEADY + 3]) > 0.6
    assert results[STEADY - 1].status == "uncertain"


def test_doubts_widen_what_the_next_frame_needs(clip):
    frames, boxes = jumped(clip, 0.6)
    tracker, _ = follow(DEFAULT, frames, boxes, STEADY)
    w = tracker._target.window.extent[0]
    calm = tracker.needed_region()
    tracker.update(frames[STEADY])
    wide = tracker.needed_region()
    assert tracker._target.reliability.doubtful
    assert calm[2] == pytest.approx(ATTENTION * w * tracker._target.scale, abs=2)
    assert wide[2] > calm[2] or wide[0] == 0 or wide[0] + wide[2] == frames[0].shape[1]
    assert wide[2] <= WIDE_ATTENTION * w * tracker._target.scale + 2


@pytest.mark.parametrize("windows", [0.5, 0.6])
def test_pixels_outside_of_what_is_needed_change_nothing(clip, windows):
    frames, boxes = jumped(clip, windows)
    assert "uncertain" in compare(DEFAULT, frames[: STEADY + 6], boxes[0])


def test_a_snapshot_remembers_doubts(clip):
    frames, boxes = jumped(clip, 0.6)
    tracker, _ = follow(DEFAULT, frames, boxes, STEADY + 1)
    assert tracker._target.reliability.doubtful
    again = MFCMT.from_bytes(tracker.to_bytes())
    for frame in frames[STEADY + 1 : STEADY + 5]:
        assert again.update(frame) == tracker.update(frame)


def test_other_peaks_are_apart_and_high():
    fused = np.zeros((11, 15), np.float32)
    fused[5, 7], fused[5, 8], fused[2, 3], fused[9, 12], fused[0, 14] = 1, 0.9, 0.8, 0.6, 0.4
    assert other_peaks(fused, (6.0, 6.0)) == [(-4, -3), (5, 4)]
    assert other_peaks(fused * 0 + fused.max(), (99.0, 99.0)) == []


def test_a_runner_behind_a_pole_is_taken_up_again(otb_root):
    """Jogging-1: hidden for a dozen frames, and then further from the last place than the window reaches."""
    sequence = open_otb(otb_root)["Jogging-1"]
    frames, boxes = [sequence.read(i) for i in range(160)], sequence.boxes
    _, results = follow(DEFAULT, frames, boxes, 160)
    assert overlap(boxes_of(results[-20:]), boxes[140:160]).min() > 0.4
    _, blind = follow(DEFAULT.replace(doubt_threshold=0.0), frames, boxes, 160)
    assert overlap(boxes_of(blind[-20:]), boxes[140:160]).max() < 0.1
