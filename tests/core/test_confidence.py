"""The confidence: what a box looks like, what the signals are, and what follows from nothing to follow."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core import MFCMT, MFCMTConfig, synthetic
from mfcmt_core.confidence import COLUMNS, DEFAULT, NOTHING
from mfcmt_core.kernels.appearance import (
    COLORS,
    GRADIENTS,
    LENGTH,
    compare_box,
    describe_box,
    deviation_of_cells,
)
from mfcmt_core.kernels.fusion import second_peak_ratio

from .helpers import PRESETS

RNG = np.random.default_rng(3)


def look_of(gray, box, channels=1, bins=None):
    bins = (gray >> 3).astype(np.uint16) if bins is None else bins
    look = np.empty(LENGTH, np.float32)
    deviation = describe_box(gray, bins, channels, *map(float, box), look)
    return look, deviation


def likeness(gray, box, first):
    bins = (gray >> 3).astype(np.uint16)
    return compare_box(gray, bins, 1, *map(float, box), first, np.empty(LENGTH, np.float32))


@pytest.fixture(scope="module")
def texture():
    coarse = RNG.integers(0, 256, (12, 12), np.uint8)
    return np.kron(coarse, np.ones((10, 10), np.uint8))


def test_a_look_is_like_itself_and_has_two_parts_of_norm_one(texture):
    box = (20, 30, 40, 50)
    look, deviation = look_of(texture, box)
    parts = np.split(look, [GRADIENTS])
    assert [len(p) for p in parts] == [GRADIENTS, COLORS]
    assert [float(p @ p) for p in parts] == pytest.approx([1, 1], abs=1e-4)
    assert deviation == pytest.approx(texture[30:80, 20:60].std(), rel=0.15)
    assert likeness(texture, box, look)[1:3] == pytest.approx([1, 1], abs=1e-4)


def test_light_and_contrast_do_not_change_gradients(texture):
    box = (20, 30, 40, 50)
    look, _ = look_of(texture, box)
    darker = (texture // 2 + 40).astype(np.uint8)
    _, gradients, colors, _ = likeness(darker, box, look)
    assert gradients > 0.95
    assert colors < 0.9


def test_another_place_is_less_alike(texture):
    look, _ = look_of(texture, (10, 10, 40, 40))
    assert likeness(texture, (70, 70, 40, 40), look)[1] < 0.8


def test_colors_that_go_on_beside_the_box_are_like_their_surroundings():
    wall = np.full((100, 100), 200, np.uint8)
    look, _ = look_of(wall, (40, 40, 20, 20))
    assert likeness(wall, (40, 40, 20, 20), look)[3] == pytest.approx(1)
    wall[40:60, 40:60] = 40
    assert likeness(wall, (40, 40, 20, 20), look)[3] == 0
    assert likeness(wall, (50, 40, 20, 20), look)[3] == pytest.approx(0.75, abs=0.15)


def test_a_box_at_the_border_repeats_it(texture):
    look, _ = look_of(texture, (-30, -30, 40, 40))
    assert np.isfinite(look).all()


def test_a_flat_box_is_like_nothing(texture):
    look, deviation = look_of(np.full((60, 60), 90, np.uint8), (10, 10, 30, 30))
    assert deviation == 0
    assert not look[:GRADIENTS].any()
    assert likeness(texture, (10, 10, 30, 30), look)[1] == 0


def test_colors_are_eight_levels_of_each_channel():
    red, blue = 31 | 0 << 10, 31 << 10
    bins = np.full((32, 32), red, np.uint16)
    bins[:, 16:] = blue
    look, _ = look_of(np.zeros((32, 32), np.uint8), (0, 0, 32, 32), 3, bins)
    colors = look[GRADIENTS:] ** 2
    assert np.flatnonzero(colors).tolist() == [7, 7 << 6]
    assert colors[7] == pytest.approx(0.5)


def test_noise_averages_out_of_cells(texture):
    noise = RNG.normal(90, 3, (120, 120)).round().clip(0, 255).astype(np.uint8)
    assert deviation_of_cells(noise) < 1
    assert deviation_of_cells(texture) > 20


def test_second_peak_over_the_first():
    assert second_peak_ratio(np.full((15, 15), 1 / 225, np.float32), 4) == pytest.approx(1)
    assert second_peak_ratio(np.zeros((15, 15), np.float32), 4) == 1
    two = np.zeros((15, 15), np.float32)
    two[3, 3], two[12, 12], two[5, 5] = 0.5, 0.2, 0.3
    assert second_peak_ratio(two, 4) == pytest.approx(0.4)  # the one beside the first does not count


def test_more_of_a_good_sign_never_lowers_the_confidence():
    assert set(DEFAULT.weights) <= set(COLUMNS)
    bad_signs = {"second_peak", "mean_second_peak", "surroundings"}
    assert {name for name, weight in DEFAULT.weights.items() if weight < 0} == bad_signs


@pytest.mark.parametrize("preset", PRESETS)
def test_a_followed_target_is_trusted_and_another_picture_is_not(preset):
    clip = synthetic.clip("motion")
    tracker = MFCMT(PRESETS[preset])
    assert tracker.init(clip.frames[0], clip.boxes[0]).confidence == 1
    followed = [tracker.update(frame).confidence for frame in clip.frames[1:30]]
    assert min(followed) > 0.8
    noise = RNG.integers(0, 256, clip.frames[0].shape, np.uint8)
    assert np.mean([tracker.update(noise).confidence for _ in range(15)][5:]) < 0.5


@pytest.mark.parametrize("preset", PRESETS)
def test_the_first_look_never_changes(preset):
    clip = synthetic.clip("motion")
    tracker = MFCMT(PRESETS[preset])
    tracker.init(clip.frames[0], clip.boxes[0])
    first = tracker._target.confidence.first.copy()
    for frame in clip.frames[1:10]:
        tracker.update(frame)
    assert (tracker._target.confidence.first == first).all()
    assert len(tracker._target.confidence.signals) == len(COLUMNS)


# --- nothing to follow ---


def noisy(level, size=(240, 320)):
    return RNG.normal(level, 1.5, (*size, 3)).round().clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("size", "box"), [((480, 640), (10, 400, 300, 60)), ((720, 1280), (5, 5, 500, 10))], ids=["wide", "flat"]
)
@pytest.mark.parametrize("level", [0, 90, 255])
def test_a_box_in_a_flat_picture_stays_and_nothing_is_reliable(size, box, level):
    frame = np.full((*size, 3), level, np.uint8)
    tracker = MFCMT()
    first = tracker.init(frame, box)
    assert first.status == "uncertain"
    assert first.confidence <= NOTHING
    for _ in range(40):
        result = tracker.update(frame)
        assert result.box == pytest.approx(box)
        assert result.confidence <= NOTHING
        assert result.status != "tracking"
        assert not result.reliable


def test_noise_of_a_dark_camera_is_nothing_to_follow():
    tracker = MFCMT()
    assert tracker.init(noisy(12), (100, 80, 60, 70)).status == "uncertain"
    results = [tracker.update(noisy(12)) for _ in range(10)]
    assert {r.status for r in results} == {"uncertain"}
    assert results[-1].box == pytest.approx((100, 80, 60, 70))


def test_a_target_that_was_begun_in_the_dark_is_not_trusted_when_the_light_comes():
    clip = synthetic.clip("motion")
    tracker = MFCMT()
    tracker.init(np.zeros_like(clip.frames[0]), clip.boxes[0])
    for frame in clip.frames[:20]:
        result = tracker.update(frame)
        assert not result.reliable
        assert result.status != "tracking"
    assert tracker.init(clip.frames[20], clip.boxes[20]).status == "tracking"
    assert tracker.update(clip.frames[21]).status == "tracking"


def test_a_picture_that_goes_dark_keeps_the_box_in_place():
    clip = synthetic.clip("motion")
    tracker = MFCMT()
    results = list(tracker.track(clip.frames[:10], clip.boxes[0]))
    dark = [tracker.update(np.zeros_like(clip.frames[0])) for _ in range(10)]
    assert dark[-1].box == results[-1].box
    assert max(r.confidence for r in dark) <= NOTHING
    assert tracker.update(clip.frames[10]).box[0] == pytest.approx(clip.boxes[10][0], abs=8)


def test_the_paper_s_preset_follows_its_tests_alone():
    config = MFCMTConfig.paper()
    frame = np.zeros((240, 320, 3), np.uint8)
    tracker = MFCMT(config)
    first = tracker.init(frame, (100, 80, 60, 70))
    assert first.status == "tracking"
    assert first.confidence <= NOTHING
    assert tracker.update(frame).status == "tracking"
