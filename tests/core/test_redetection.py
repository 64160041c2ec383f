"""The search of the whole frame: a target that is lost comes back elsewhere and at another size."""

from __future__ import annotations

import cv2
import msgpack
import numpy as np
import pytest

from mfcmt_core import MFCMT, BadSnapshot, MFCMTConfig, synthetic
from mfcmt_core.confidence import BoxPixels
from mfcmt_core.geometry import Frame
from mfcmt_core.kernels.appearance import SIDE
from mfcmt_core.otb.metrics import overlap
from mfcmt_core.redetection import LOOK_SCALES, Looks

DEFAULT = MFCMTConfig.default()

PATIENCE = 2 * len(LOOK_SCALES)
"""Number of searches in which each look is searched at each size."""


@pytest.fixture(scope="module")
def scene():
    """Return a frame with the target, its box, and the frame without the target."""
    clip = synthetic.clip("motion", grain=1.0)
    shown = clip.frames[0]
    x, y, w, h = (int(v) for v in np.rint(clip.boxes[0]))
    empty = shown.copy()
    empty[y - 2 : y + h + 2, x - 2 : x + w + 2] = shown[:48, 250:310]
    return shown, (x, y, w, h), empty


def paste(scene, place, size):
    """Return the empty frame with the target at ``place``, ``size`` times as large, and its box."""
    shown, (x, y, w, h), empty = scene
    target = cv2.resize(shown[y : y + h, x : x + w], None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    rows, columns = target.shape[:2]
    frame = empty.copy()
    frame[place[1] : place[1] + rows, place[0] : place[0] + columns] = target
    return frame, (*place, columns, rows)


def remembered(scene):
    shown, box, _ = scene
    gray, looks = cv2.cvtColor(shown, cv2.COLOR_BGR2GRAY), Looks()
    bins = np.zeros_like(gray, np.uint16)
    looks.remember(BoxPixels(gray, bins, 1, *map(float, box), inside=1.0))
    return looks


@pytest.mark.parametrize("place", [(8, 5), (60, 150), (230, 20)])
@pytest.mark.parametrize("size", LOOK_SCALES)
def test_the_place_that_looks_like_the_target_is_proposed_with_its_size(scene, place, size):
    frame, box = paste(scene, place, size)
    looks, base_size = remembered(scene), scene[1][2:]
    found = [looks.propose(Frame.of(frame), base_size, 1.0) for _ in range(PATIENCE)]
    (x, y), scale = next(proposal for proposal in found if proposal[1] == size)
    w, h = base_size[0] * scale, base_size[1] * scale
    assert overlap(np.array([[x - w / 2, y - h / 2, w, h]]), np.array([box], float))[0] > 0.6


def test_nothing_is_proposed_without_a_look_or_where_it_does_not_fit(scene):
    frame = Frame.of(scene[0])
    assert Looks().propose(frame, (40.0, 40.0), 1.0) is None
    assert remembered(scene).propose(frame, (400.0, 40.0), 1.0) is None
    assert remembered(scene).propose(Frame.of(scene[0][:1, :1]), (40.0, 40.0), 1.0) is None


def test_the_first_look_stays_and_the_latest_changes(scene):
    looks = remembered(scene)
    first = looks.first.copy()
    gray = cv2.cvtColor(scene[2], cv2.COLOR_BGR2GRAY)
    looks.remember(BoxPixels(gray, np.zeros_like(gray, np.uint16), 1, 10.0, 10.0, 30.0, 30.0, inside=1.0))
    assert np.array_equal(looks.first, first)
    assert not np.array_equal(looks.latest, first)


def gone(scene, config=DEFAULT, seconds=8):
    """Return a tracker whose target has vanished for that many frames."""
    shown, box, empty = scene
    tracker = MFCMT(config)
    tracker.init(shown, box)
    for _ in range(15):
        tracker.update(shown)
    for _ in range(seconds):
        tracker.update(empty)
    return tracker


@pytest.mark.parametrize("place", [(8, 5), (60, 150), (230, 20)])
@pytest.mark.parametrize("size", [0.75, 1.0, 1.33])
def test_a_target_comes_back_elsewhere_and_at_another_size(scene, place, size):
    tracker = gone(scene, seconds=20)
    frame, box = paste(scene, place, size)
    results = [tracker.update(frame) for _ in range(2 * PATIENCE)]
    assert results[-1].status == "tracking"
    assert overlap(np.array([results[-1].box]), np.array([box], float))[0] > 0.6


def test_the_whole_frame_is_needed_after_four_frames_of_low_confidence(scene):
    tracker = gone(scene, seconds=0)
    low = 0
    for _ in range(30):
        assert (tracker.needed_region() == (0, 0, 320, 240)) == (low >= DEFAULT.search_after)
        low = low + 1 if tracker.update(scene[2]).confidence < DEFAULT.lost_threshold else 0
    assert low > DEFAULT.search_after


def test_without_search_after_the_whole_frame_is_needed_only_when_the_target_is_lost(scene):
    tracker = gone(scene, DEFAULT.replace(search_after=0), seconds=0)
    for _ in range(40):
        status = tracker.update(scene[2]).status
        assert (tracker.needed_region() == (0, 0, 320, 240)) == (status == "lost")
    assert status == "lost"


@pytest.mark.parametrize("gray", [False, True])
def test_nothing_is_taken_for_a_target_that_is_away(gray):
    clip = synthetic.clip("leaves", gray=gray)
    results = list(MFCMT().track(clip.frames, clip.boxes[0]))
    away = [result.status for result, shown in zip(results, clip.shown, strict=True) if not shown]
    assert "tracking" not in away


def test_a_snapshot_in_the_middle_of_a_search_goes_on_as_the_tracker_does(scene):
    tracker = gone(scene)
    restored = MFCMT.from_bytes(tracker.to_bytes())
    frame, _ = paste(scene, (60, 150), 0.75)
    for _ in range(2 * PATIENCE):
        assert restored.update(frame) == tracker.update(frame)


def test_a_target_of_fixed_size_comes_back_at_that_size(scene):
    tracker = gone(scene, DEFAULT.replace(num_scales=1), seconds=20)
    frame, _ = paste(scene, (60, 150), 1.0)
    results = [tracker.update(frame) for _ in range(2 * PATIENCE)]
    assert results[-1].status == "tracking"
    assert {result.scale for result in results} == {1.0}


def test_a_snapshot_with_looks_that_no_pixel_has_is_refused(scene):
    document = msgpack.unpackb(gone(scene).to_bytes())
    look = document["arrays"]["search_look_latest"]
    look["data"] = np.full((SIDE, SIDE), 256, "<f4").tobytes()
    with pytest.raises(BadSnapshot, match="looks"):
        MFCMT.from_bytes(msgpack.packb(document))
