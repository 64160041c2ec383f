"""A target that jumps out of its window: doubts, other places, and the part of the frame that they need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mfcmt_core import MFCMT, MFCMTConfig, synthetic
from mfcmt_core.geometry import Frame
from mfcmt_core.otb.dataset import open_otb
from mfcmt_core.otb.metrics import overlap
from mfcmt_core.redetection import other_peak
from mfcmt_core.reliability import Peaks
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
def test_a_jump_beyond_the_window_is_followed_within_six_frames(clip, windows):
    """One leaves doubts, four look to a side each, the last to what one of them has shown."""
    frames, boxes = jumped(clip, windows)
    _, results = follow(DEFAULT, frames, boxes, STEADY + 6)
    assert iou(results[STEADY - 2].box, boxes[STEADY - 1]) > 0.7
    assert iou(results[-1].box, boxes[STEADY + 5]) > 0.6
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


@pytest.mark.parametrize("windows", [0.5, 0.6, -0.65])
def test_pixels_outside_of_what_is_needed_change_nothing(clip, windows):
    frames, boxes = jumped(clip, windows)
    assert "uncertain" in compare(DEFAULT, frames[: STEADY + 6], boxes[0])


def test_a_snapshot_remembers_doubts_and_rivals(clip):
    frames, boxes = jumped(clip, -0.65)
    _, plain = follow(DEFAULT, frames, boxes, STEADY + 8)
    tracker, _ = follow(DEFAULT, frames, boxes, STEADY)
    doubts, rivals = [], []
    for at in range(STEADY, STEADY + 6):
        tracker.update(frames[at])
        again = MFCMT.from_bytes(tracker.to_bytes())
        assert again._target.rival == tracker._target.rival
        assert [again.update(frame) for frame in frames[at + 1 : STEADY + 8]] == plain[at:]
        doubts.append(tracker._target.reliability.doubtful)
        rivals.append(tracker._target.rival is not None)
    assert any(doubts)
    assert any(rivals)


@pytest.fixture
def search(clip, monkeypatch):
    """A search of the frame after the steady ones whose every look finds what it is told to.

    A function of whether the last frame left doubts, its rival, and (template peak over the usual one, displacement) a
    look, the last for all others; it returns the places and cuts that were looked at, all looks, and the one chosen.
    """
    tracker, _ = follow(DEFAULT, *jumped(clip, 0.0), STEADY)
    target = tracker._target
    frame, within = Frame.of(clip.frames[STEADY]), (0, 0, *clip.frames[STEADY].shape[1::-1])

    def run(was_doubtful, *told, rival=None):
        asked, looks, real = [], [], MFCMT._look

        def look(self, target, frame, within, place, cut=None):
            true = real(self, target, frame, within, place, cut)
            part, displacement = told[min(len(looks), len(told) - 1)]
            peaks = Peaks(true.found.peaks.fused, part * target.reliability.usual[0], 0.5)
            found = replace(true.found, center=true.seen.displaced(displacement), peaks=peaks)
            looks.append(replace(true, found=found))
            asked.append((place, cut))
            return looks[-1]

        monkeypatch.setattr(MFCMT, "_look", look)
        target.reliability.doubtful, target.rival = was_doubtful, rival
        chosen = tracker._search(target, frame, within)
        return asked, looks, chosen, target.rival

    return run


def test_without_doubts_one_look_is_enough(search):
    for was_doubtful in (False, True):
        _, looks, chosen, rival = search(was_doubtful, (0.7, (3, 0)), rival=(50.0, 50.0))
        assert looks == [chosen]
        assert rival is None


@pytest.mark.parametrize(("displacement", "again"), [((0.5, -0.9), False), ((1.2, 0), True), ((0, -3), True)])
def test_a_peak_in_the_middle_of_its_window_is_not_looked_at_again(search, displacement, again):
    """Further off the window is moved to it, in the same cut."""
    asked, looks, chosen, _ = search(False, (0.3, displacement), (0.4, (0, 0)))
    first = looks[0]
    centred = [(place, cut) for place, cut in asked if cut is not None]
    assert centred == ([(first.found.center, first.seen.cut)] if again else [])
    assert chosen.seen is first.seen
    assert chosen.closer is (looks[1].seen if again else None)


def test_a_centred_look_may_end_the_doubts(search):
    asked, looks, chosen, rival = search(False, (0.3, (3, 0)), (0.9, (0, 0)))
    assert len(asked) == 2
    assert chosen.seen is looks[0].seen
    assert rival is None


@pytest.mark.parametrize(("peak", "moves", "remembered"), [(0.3, False, False), (0.4, False, True), (0.9, True, False)])
@pytest.mark.parametrize("off", [(0, 0), (3, 0)])
def test_another_place_must_be_twice_as_high_and_is_remembered_if_it_is_higher(search, peak, moves, remembered, off):
    """With the middle of the target's own, three looks at most."""
    told = [(0.35, off)] + ([(0.35, (0, 0))] if any(off) else []) + [(peak, (1, 1))]
    asked, looks, chosen, rival = search(True, *told)
    assert len(looks) == len(told)
    assert asked[-1][1] is None
    assert chosen.seen is looks[-1 if moves else 0].seen
    assert rival == (looks[-1].found.center if remembered else None)


def test_a_place_remembered_is_looked_at_before_any_other(search):
    asked, _, _, rival = search(True, (0.3, (0, 0)), rival=(50.0, 60.0))
    assert [place for place, _ in asked[1:]] == [(50.0, 60.0)]
    assert rival is None


def test_places_outside_of_the_frame_are_not_looked_at(search):
    asked, _, _, _ = search(True, (0.3, (0, 0)), rival=(-1.0, 60.0))
    assert len(asked) == 1


def test_lasting_doubts_look_to_all_four_sides_in_turn(clip):
    """Half a window away each."""
    tracker, _ = follow(DEFAULT, *jumped(clip, 0.0), STEADY)
    target = tracker._target
    (x, y), (w, h) = target.center, target.window.extent
    around = [target.window.neighbour((x, y), 2.0, side) for side in range(4)]
    assert around == [(x - w, y), (x, y - h), (x + w, y), (x, y + h)]


def test_the_other_peak_is_apart_and_high():
    fused = np.zeros((11, 15), np.float32)
    fused[5, 7], fused[5, 8], fused[2, 3], fused[9, 12] = 1, 0.9, 0.8, 0.6
    assert other_peak(fused, (6.0, 6.0)) == (-4, -3)
    fused[2, 3] = fused[9, 12] = 0.4
    assert other_peak(fused, (6.0, 6.0)) is None
    assert other_peak(fused * 0 + 1, (99.0, 99.0)) is None


def test_a_runner_behind_a_pole_is_taken_up_again(otb_root):
    """Jogging-1: hidden for a dozen frames, and then further from the last place than the window reaches."""
    sequence = open_otb(otb_root)["Jogging-1"]
    frames, boxes = [sequence.read(i) for i in range(160)], sequence.boxes
    _, results = follow(DEFAULT, frames, boxes, 160)
    assert overlap(boxes_of(results[-20:]), boxes[140:160]).min() > 0.4
    _, blind = follow(DEFAULT.replace(doubt_threshold=0.0), frames, boxes, 160)
    assert overlap(boxes_of(blind[-20:]), boxes[140:160]).max() < 0.1
