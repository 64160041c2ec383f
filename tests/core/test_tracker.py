"""The tracker on rendered sequences, whose truth is exact."""

from __future__ import annotations

import dataclasses
import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMT, BadBox, MFCMTConfig, TrackResult, synthetic
from mfcmt_core.otb.metrics import overlap
from mfcmt_core.reliability import Reliability
from mfcmt_core.scale import ScaleModel
from mfcmt_core.target import Observation, Target

from .helpers import ALERT, PRESETS, assert_sane, boxes_of, track

DEFAULT = MFCMTConfig.default()


# --- sequences with exact truth ---


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(
    ("scene", "changes", "mean", "worst"),
    [
        ("motion", {}, 0.85, 0.7),
        ("scale", {}, 0.85, 0.7),
        ("illumination", {}, 0.85, 0.7),
        ("occlusion", {}, 0.85, 0.6),
        ("distractors", {}, 0.85, 0.7),
        ("grey", {}, 0.85, 0.7),
        ("small", {}, 0.8, 0.6),
        ("large", {"length": 10, "speed": 0.01}, 0.85, 0.7),
        ("sample", {"length": 100}, 0.6, 0.4),
    ],
)
def test_each_scene_is_tracked_with_the_accuracy_that_it_allows(scene, changes, mean, worst, preset):
    sequence = synthetic.clip(scene, **changes)
    results = track(PRESETS[preset], list(sequence.frames), sequence.boxes[0])
    seen = overlap(boxes_of(results), sequence.boxes)[sequence.visible]
    assert seen.mean() > mean
    assert seen.min() > worst


def test_the_scale_follows_the_target():
    sequence = synthetic.clip("scale")
    results = track(DEFAULT, list(sequence.frames), sequence.boxes[0])
    truth = sequence.boxes[:, 2] / sequence.boxes[0, 2]
    assert truth.max() > 1.4
    assert np.array([r.scale for r in results]) == pytest.approx(truth, rel=0.12)
    for result in results:
        assert result.box[2:] == pytest.approx((56 * result.scale, 44 * result.scale))


@pytest.mark.parametrize(
    "config",
    [*PRESETS.values(), DEFAULT.replace(scale_interval=1), DEFAULT.replace(scale_when_reliable=False, lost_after=0)],
    ids=["2", "paper", "1", "unreliable"],
)
def test_the_scale_is_searched_and_learned_in_every_nth_learned_frame(config, monkeypatch):
    """Frames that nothing is learned from do not count; where they may search it, too, each does.

    A learned frame in doubt leaves it to the next, but not for longer than twice the interval.
    """
    called = []

    def spy(name):
        method = getattr(ScaleModel, name)

        def spied(self, *args, **kwargs):
            called.append(name)
            return method(self, *args, **kwargs)

        monkeypatch.setattr(ScaleModel, name, spied)

    spy("estimate")
    spy("learn")
    sequence = synthetic.clip("occlusion", hide=0.9)
    tracker = MFCMT(config)
    results = [tracker.init(sequence.frames[0], sequence.boxes[0])]
    assert called == ["learn"]
    learned = waited = left = 0
    for frame in sequence.frames[1:]:
        called.clear()
        results.append(tracker.update(frame))
        learned += results[-1].updated
        waited += results[-1].updated
        template_low = tracker._target.reliability.template_low
        if results[-1].updated and waited >= config.scale_interval * (2 if template_low else 1):
            assert called == ["estimate", "learn"]
            waited = 0
        elif not (results[-1].updated or config.scale_when_reliable):
            assert called == ["estimate"]
        else:
            assert called == []
            assert results[-1].scale == results[-2].scale
            left += waited >= config.scale_interval
    assert (left > 0) == (config.doubt_threshold > 0)
    assert 0 < learned < len(results) - 1


def test_an_occlusion_stops_learning():
    sequence = synthetic.clip("occlusion", hide=0.9)
    results = track(DEFAULT, list(sequence.frames), sequence.boxes[0])
    hidden = sequence.shown < 0.3
    assert hidden.any()
    assert not all(r.updated for r, away in zip(results, hidden, strict=True) if away)
    clear = [r.status for r, shown in zip(results, sequence.shown, strict=True) if shown > 0.99]
    assert clear.count("tracking") > 0.9 * len(clear)


@pytest.mark.parametrize(
    ("config", "gray"),
    [
        (DEFAULT.replace(lost_after=15), False),
        (ALERT, False),
        (ALERT, True),
        (MFCMTConfig.paper().replace(lost_after=8), False),
        (MFCMTConfig.paper().replace(lost_after=8), True),
    ],
)
def test_a_target_that_leaves_is_lost_and_found_again(config, gray):
    sequence = synthetic.clip("leaves", gray=gray)
    tracker = MFCMT(config)
    results = []
    for index, frame in enumerate(sequence.frames):
        results.append(tracker.update(frame) if index else tracker.init(frame, sequence.boxes[0]))
        assert_sane(results[-1], (320, 240))
        if results[-1].status == "lost":  # the last box that was reliable, and the whole frame is searched
            assert not results[-1].updated
            assert tracker.needed_region() == (0, 0, 320, 240)
            assert results[-1].box == next(r.box for r in reversed(results) if r.reliable)
    statuses = [r.status for r in results]
    middle = statuses[75:92]  # nothing of it is in the frame
    assert not sequence.shown[75:92].any()
    assert middle.count("lost") == len(middle)
    assert statuses[-1] == "tracking"
    assert overlap(boxes_of(results), sequence.boxes)[-20:].min() > 0.6


@pytest.mark.parametrize("config", [ALERT, MFCMTConfig.paper().replace(lost_after=8)], ids=["alert", "paper"])
@pytest.mark.parametrize("place", [(8, 5), (40, 30), (60, 150), (230, 20)])
def test_a_target_is_found_again_elsewhere(config, place):
    """It vanishes and comes back far away, where only the search of the whole frame finds it."""
    sequence = synthetic.clip("motion", grain=1.0)
    x, y, w, h = np.rint(sequence.boxes[0]).astype(int)
    shown = sequence.frames[0]
    empty = shown.copy()
    empty[y - 2 : y + h + 2, x - 2 : x + w + 2] = shown[:48, 250:310]
    moved = empty.copy()
    moved[place[1] : place[1] + h, place[0] : place[0] + w] = shown[y : y + h, x : x + w]
    tracker = MFCMT(config)
    tracker.init(shown, (x, y, w, h))
    for _ in range(15):
        tracker.update(shown)
    statuses = [tracker.update(empty).status for _ in range(20)]
    assert statuses[-1] == "lost"
    results = [tracker.update(moved) for _ in range(10)]
    assert results[-1].status == "tracking"
    assert overlap(boxes_of(results[-1:]), np.array([[*place, w, h]], float))[0] > 0.6


def test_colors_alone_find_a_lost_target():
    green = np.full((240, 320, 3), (40, 120, 40), np.uint8)
    config = ALERT.replace(features=(), num_scales=1, lost_after=3, tracking_threshold=0.0)

    def frame(x, y):
        image = green.copy()
        image[y : y + 40, x : x + 40] = (30, 30, 220)
        return image

    tracker = MFCMT(config)
    tracker.init(frame(40, 40), (40, 40, 40, 40))
    for _ in range(12):
        tracker.update(frame(40, 40))
    statuses = [tracker.update(green).status for _ in range(6)]
    assert statuses[-1] == "lost"
    results = [tracker.update(frame(250, 180)) for _ in range(5)]
    assert results[-1].status == "tracking"
    assert overlap(boxes_of(results[-1:]), np.array([[250.0, 180, 40, 40]]))[0] > 0.6


# --- targets and frames of every shape ---


def drifting(size, seed=0, count=5, gray=False):
    """Return frames of smooth noise of ``size`` (w, h) that moves by one pixel per frame."""
    rng = np.random.default_rng(seed)
    channels = () if gray else (3,)
    coarse = rng.integers(0, 256, (size[1] // 4 + 8, size[0] // 4 + 8, *channels), np.uint8)
    image = cv2.resize(coarse, (size[0] + 16, size[1] + 16), interpolation=cv2.INTER_CUBIC)
    return [np.ascontiguousarray(image[k : k + size[1], k : k + size[0]]) for k in range(count)]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(
    ("size", "box"),
    [
        ((320, 240), (-20, -20, 40, 40)),  # a corner: a quarter inside
        ((320, 240), (300, 220, 40, 40)),
        ((320, 240), (0, 100, 8, 8)),
        ((320, 240), (312, 100, 8, 8)),
        ((320, 240), (-300, 100, 400, 20)),  # a quarter inside, the middle outside
        ((320, 240), (100, 100, 1, 1)),
        ((320, 240), (100.3, 100.7, 1, 1)),
        ((320, 240), (0, 0, 320, 240)),  # the frame itself
        ((320, 240), (-160, -120, 640, 480)),  # larger than the frame
        ((320, 240), (160, 20, 4, 200)),
        ((320, 240), (10, 120, 300, 4)),
        ((16, 16), (4, 4, 8, 8)),
        ((16, 16), (0, 0, 16, 16)),
        ((1, 1), (0, 0, 1, 1)),
        ((2, 300), (0, 100, 2, 100)),
        ((400, 3), (100, 0, 50, 3)),
        ((1500, 1200), (200, 100, 1000, 1000)),
    ],
)
def test_any_target_in_any_frame(size, box, preset):
    frames = drifting(size)
    results = track(PRESETS[preset], frames, box)
    assert results[0].box == box
    for result in results[1:]:
        assert result.box[2] / result.box[3] == pytest.approx(box[2] / box[3])


@settings(max_examples=60)
@given(
    st.tuples(st.integers(1, 90), st.integers(1, 90)),
    st.tuples(st.floats(-1, 2), st.floats(-1, 2)),
    st.tuples(st.floats(0.1, 120), st.floats(0.1, 120)),
    st.sampled_from([*PRESETS.values(), DEFAULT.replace(window="square"), DEFAULT.replace(features=())]),
    st.booleans(),
)
def test_every_accepted_box_is_tracked(size, place, sides, config, gray):
    frames = drifting(size, gray=gray, count=3)
    box = (place[0] * size[0], place[1] * size[1], *sides)
    try:
        MFCMT(config).init(frames[0], box)
    except BadBox:
        return
    track(config, frames, box)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("value", [0, 77, 255])
def test_frames_without_content_break_nothing(value, preset, frames, clip):
    """From the first frame on nothing moves, and in the middle of a sequence nothing breaks."""
    flat = np.full_like(frames[0], value)
    results = track(PRESETS[preset], [flat] * 12, (100, 90, 60, 40))
    assert all(r.scale == 1 for r in results)
    mixed = [*frames[:3], *[flat] * 5, *frames[3:6]]
    track(PRESETS[preset], mixed, clip.boxes[0])


def test_a_change_to_another_scene_is_not_learned(frames, clip):
    noise = np.random.default_rng(0).integers(0, 256, frames[0].shape, np.uint8)
    tracker = MFCMT(DEFAULT)
    tracker.init(frames[0], clip.boxes[0])
    for frame in frames[1:12]:
        assert tracker.update(frame).updated
    result = tracker.update(noise)
    assert (result.reliable, result.updated) == (False, False)
    after = tracker.update(noise)
    assert (after.status, after.updated) == ("uncertain", False)
    assert result.scale == after.scale


def test_a_recentered_window_is_learned_without_observing_it_again(frames, clip, monkeypatch):
    """The tracker learns from the recentered window that it probed, where that fits, and gets the same results."""
    answers = itertools.cycle([True, False])
    monkeypatch.setattr(Reliability, "is_template_low", lambda *_: next(answers))
    monkeypatch.setattr(Observation, "is_central", lambda *_: False)
    observe, calls = Target.observe, []

    def counted(*args):
        calls.append(args)
        return observe(*args)

    monkeypatch.setattr(Target, "observe", counted)
    results = track(DEFAULT, frames[::2], clip.boxes[0])
    looks = len(calls)
    calls.clear()
    monkeypatch.setattr(Target, "can_reuse", lambda *_: False)
    assert track(DEFAULT, frames[::2], clip.boxes[0]) == results
    assert len(calls) > looks


# --- the interface ---


def test_the_first_result_is_the_given_box_without_scores(frames, clip):
    first = MFCMT().init(frames[0], clip.boxes[0])
    assert first == TrackResult(tuple(clip.boxes[0]), "tracking", None, None, None, None, True, 1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        first.status = "lost"


def test_track_reads_no_further_than_asked(frames, clip):
    read = []

    def camera():
        for index, frame in enumerate(frames):
            read.append(index)
            yield frame

    results = MFCMT().track(camera(), clip.boxes[0])
    assert read == []
    assert next(results).scores is None
    assert next(results).scores is not None
    assert read == [0, 1]
    assert list(MFCMT().track([], clip.boxes[0])) == []


def test_starting_again_forgets_everything(frames, clip):
    fresh, used = MFCMT(), MFCMT()
    used.init(frames[5], (30, 30, 50, 60))
    for frame in frames[6:12]:
        used.update(frame)
    for tracker in (fresh, used):
        tracker.init(frames[0], clip.boxes[0])
    assert used.to_bytes() == fresh.to_bytes()
    assert used.update(frames[1]) == fresh.update(frames[1])


def test_a_new_start_may_have_another_frame_size(frames, clip):
    tracker = MFCMT()
    tracker.init(frames[0], clip.boxes[0])
    half = frames[1][:120, :160]
    tracker.init(half, (20, 20, 50, 40))
    assert_sane(tracker.update(half), (160, 120))


@pytest.mark.parametrize("config", [DEFAULT, MFCMTConfig.paper(), DEFAULT.replace(color_histogram=False)])
def test_maps_are_probability_maps(config, frames, clip):
    with_maps, without = MFCMT(config), MFCMT(config)
    for tracker in (with_maps, without):
        tracker.init(frames[0], clip.boxes[0])
    for frame in frames[1:4]:
        result = with_maps.update(frame, maps=True)
        plain = without.update(frame)
        assert plain.maps is None
        assert dataclasses.replace(result, maps=None) == plain
        names = ["template"] if config.joint_filter else list(config.features)
        names += ["background"] if config.background_interval else []
        names += ["statistical"] if config.color_histogram else []
        parts = config.features if config.joint_filter else []
        assert list(result.maps) == ["fused", *names, *parts]
        assert len({m.shape for m in result.maps.values()}) == 1
        for values in result.maps.values():
            assert values.dtype == np.float32
            assert values.shape[0] % 2 == values.shape[1] % 2 == 1
            assert values.min() >= 0
            assert values.sum(dtype=float) == pytest.approx(1, abs=1e-4)
    kept = {name: values.copy() for name, values in result.maps.items()}
    with_maps.update(frames[4])
    assert all(np.array_equal(result.maps[name], kept[name]) for name in kept)  # not scratch


def test_regions_contain_the_needed_region_and_grow_with_the_lag(frames, clip):
    tracker = MFCMT()
    tracker.init(frames[0], clip.boxes[0])
    for frame in frames[1:6]:
        tracker.update(frame)
        x, y, w, h = tracker.needed_region()
        bx, by, bw, bh = MFCMT.from_bytes(tracker.to_bytes()).update(frame).box
        assert x <= bx
        assert y <= by
        assert x + w >= bx + bw
        assert y + h >= by + bh
        previous = (x, y, w, h)
        for lag in (0, 1, 2, 5, 100):
            rx, ry, rw, rh = tracker.region(lag)
            assert rx <= previous[0]
            assert ry <= previous[1]
            assert rx + rw >= previous[0] + previous[2]
            assert ry + rh >= previous[1] + previous[3]
            previous = (rx, ry, rw, rh)
        assert previous == (0, 0, 320, 240)
