"""A target that jumps out of its search window: other places are probed, and a wider region is needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mfcmt_core import MFCMT, MFCMTConfig, synthetic
from mfcmt_core.geometry import Frame
from mfcmt_core.otb.dataset import open_otb
from mfcmt_core.otb.metrics import overlap
from mfcmt_core.redetection import second_peak
from mfcmt_core.reliability import Peaks
from mfcmt_core.search import Search
from mfcmt_core.tracker import REGION_FACTOR, WIDE_REGION_FACTOR

from .helpers import boxes_of
from .test_regions import compare

DEFAULT = MFCMTConfig.default().replace(tracking_threshold=0.0)
"""With the status of the three tests, which fail where the template peak is low."""
STEADY = 20
"""Frames before the jump: the long-term means need ten."""


@pytest.fixture(scope="module")
def clip():
    return synthetic.clip("motion")


def jumped(clip, windows: float):
    """Frames and boxes whose picture moves to the right by ``windows`` search windows after the steady ones."""
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
    """The template peak is low in one frame, four frames probe a side each, and the last one moves there."""
    frames, boxes = jumped(clip, windows)
    _, results = follow(DEFAULT, frames, boxes, STEADY + 6)
    assert iou(results[STEADY - 2].box, boxes[STEADY - 1]) > 0.7
    assert iou(results[-1].box, boxes[STEADY + 5]) > 0.6
    assert results[STEADY - 1].status == "uncertain"


def test_a_low_template_peak_widens_the_region_that_the_next_frame_needs(clip):
    frames, boxes = jumped(clip, 0.6)
    tracker, _ = follow(DEFAULT, frames, boxes, STEADY)
    w = tracker._target.search_window.extent[0]
    calm = tracker.needed_region()
    tracker.update(frames[STEADY])
    wide = tracker.needed_region()
    assert tracker._target.reliability.template_low
    assert calm[2] == pytest.approx(REGION_FACTOR * w * tracker._target.scale, abs=2)
    assert wide[2] > calm[2] or wide[0] == 0 or wide[0] + wide[2] == frames[0].shape[1]
    assert wide[2] <= WIDE_REGION_FACTOR * w * tracker._target.scale + 2


@pytest.mark.parametrize("windows", [0.5, 0.6, -0.65])
def test_pixels_outside_the_needed_region_change_nothing(clip, windows):
    frames, boxes = jumped(clip, windows)
    assert "uncertain" in compare(DEFAULT, frames[: STEADY + 6], boxes[0])


def test_a_snapshot_keeps_the_low_template_peak_and_the_runner_up(clip):
    frames, boxes = jumped(clip, -0.65)
    _, plain = follow(DEFAULT, frames, boxes, STEADY + 8)
    tracker, _ = follow(DEFAULT, frames, boxes, STEADY)
    low, runners_up = [], []
    for at in range(STEADY, STEADY + 6):
        tracker.update(frames[at])
        again = MFCMT.from_bytes(tracker.to_bytes())
        assert again._target.runner_up == tracker._target.runner_up
        assert [again.update(frame) for frame in frames[at + 1 : STEADY + 8]] == plain[at:]
        low.append(tracker._target.reliability.template_low)
        runners_up.append(tracker._target.runner_up is not None)
    assert any(low)
    assert any(runners_up)


@pytest.fixture
def search(clip, monkeypatch):
    """Return a function that searches the frame after the steady ones with scripted detections.

    It takes whether the last template peak was low, one (template peak over its long-term mean, displacement) per
    probe, the last of which stands for all further probes, and the runner-up of the last frame. It returns the probed
    (place, crop) pairs, all candidates, the chosen one, and the new runner-up.
    """
    tracker, _ = follow(DEFAULT, *jumped(clip, 0.0), STEADY)
    target = tracker._target
    frame, readable = Frame.of(clip.frames[STEADY]), (0, 0, *clip.frames[STEADY].shape[1::-1])

    def run(was_low, *script, runner_up=None):
        probed, candidates, real = [], [], Search.probe

        def probe(self, place, crop=None):
            true = real(self, place, crop)
            part, displacement = script[min(len(candidates), len(script) - 1)]
            peaks = Peaks(true.detection.peaks.fused, part * target.reliability.long_term_means[0], 0.5)
            detection = replace(true.detection, center=true.observation.place_at(displacement), peaks=peaks)
            candidates.append(replace(true, detection=detection))
            probed.append((place, crop))
            return candidates[-1]

        monkeypatch.setattr(Search, "probe", probe)
        target.reliability.template_low, target.runner_up = was_low, runner_up
        chosen = Search(DEFAULT, target, frame, readable).run()
        return probed, candidates, chosen, target.runner_up

    return run


def test_a_high_template_peak_needs_one_probe(search):
    for was_low in (False, True):
        _, candidates, chosen, runner_up = search(was_low, (0.7, (3, 0)), runner_up=(50.0, 50.0))
        assert candidates == [chosen]
        assert runner_up is None


@pytest.mark.parametrize(("displacement", "again"), [((0.5, -0.9), False), ((1.2, 0), True), ((0, -3), True)])
def test_a_peak_in_the_middle_of_its_window_is_not_probed_again(search, displacement, again):
    """A peak further off is probed again from a window around it, in the same crop."""
    probed, candidates, chosen, _ = search(False, (0.3, displacement), (0.4, (0, 0)))
    first = candidates[0]
    centered = [(place, crop) for place, crop in probed if crop is not None]
    assert centered == ([(first.detection.center, first.observation.crop)] if again else [])
    assert chosen.observation is first.observation
    assert chosen.recentered is (candidates[1].observation if again else None)


def test_a_high_peak_in_the_recentered_window_ends_the_search(search):
    probed, candidates, chosen, runner_up = search(False, (0.3, (3, 0)), (0.9, (0, 0)))
    assert len(probed) == 2
    assert chosen.observation is candidates[0].observation
    assert runner_up is None


@pytest.mark.parametrize(("peak", "moves", "remembered"), [(0.3, False, False), (0.4, False, True), (0.9, True, False)])
@pytest.mark.parametrize("off", [(0, 0), (3, 0)])
def test_another_place_must_be_twice_as_high_and_is_remembered_if_it_is_higher(search, peak, moves, remembered, off):
    """Together with the recentered window that makes three probes at most."""
    script = [(0.35, off)] + ([(0.35, (0, 0))] if any(off) else []) + [(peak, (1, 1))]
    probed, candidates, chosen, runner_up = search(True, *script)
    assert len(candidates) == len(script)
    assert probed[-1][1] is None
    assert chosen.observation is candidates[-1 if moves else 0].observation
    assert runner_up == (candidates[-1].detection.center if remembered else None)


def test_the_runner_up_is_probed_before_any_other_place(search):
    probed, _, _, runner_up = search(True, (0.3, (0, 0)), runner_up=(50.0, 60.0))
    assert [place for place, _ in probed[1:]] == [(50.0, 60.0)]
    assert runner_up is None


def test_places_outside_the_frame_are_not_probed(search):
    probed, _, _, _ = search(True, (0.3, (0, 0)), runner_up=(-1.0, 60.0))
    assert len(probed) == 1


def test_neighboring_windows_lie_half_a_window_to_each_side(clip):
    tracker, _ = follow(DEFAULT, *jumped(clip, 0.0), STEADY)
    target = tracker._target
    (x, y), (w, h) = target.center, target.search_window.extent
    around = [target.search_window.neighbor((x, y), 2.0, side) for side in range(4)]
    assert around == [(x - w, y), (x, y - h), (x + w, y), (x, y + h)]


def test_the_second_peak_is_apart_from_the_first_and_at_least_half_as_high():
    fused = np.zeros((11, 15), np.float32)
    fused[5, 7], fused[5, 8], fused[2, 3], fused[9, 12] = 1, 0.9, 0.8, 0.6
    assert second_peak(fused, (6.0, 6.0)) == (-4, -3)
    fused[2, 3] = fused[9, 12] = 0.4
    assert second_peak(fused, (6.0, 6.0)) is None
    assert second_peak(fused * 0 + 1, (99.0, 99.0)) is None


def test_a_runner_behind_a_pole_is_found_again(otb_root):
    """In Jogging-1 the runner is hidden for a dozen frames, and then is outside the search window."""
    sequence = open_otb(otb_root)["Jogging-1"]
    frames, boxes = [sequence.read(i) for i in range(160)], sequence.boxes
    _, results = follow(DEFAULT, frames, boxes, 160)
    assert overlap(boxes_of(results[-20:]), boxes[140:160]).min() > 0.4
    _, blind = follow(DEFAULT.replace(doubt_threshold=0.0, search_after=0), frames, boxes, 160)
    assert overlap(boxes_of(blind[-20:]), boxes[140:160]).max() < 0.1
