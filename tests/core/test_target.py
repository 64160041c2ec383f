"""What the models of one target see of a frame: one cut, and windows in it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMTConfig, synthetic
from mfcmt_core.geometry import Frame
from mfcmt_core.target import Target, as_mode, is_grey

DEFAULT = MFCMTConfig.default()
ANEW = DEFAULT.replace(learn_within=0.0)
CONFIGS = {"default": DEFAULT, "anew": ANEW, "paper": MFCMTConfig.paper()}
PLACE = (160.0, 120.0)
WITHIN = (0, 0, 320, 240)
MARGIN = 12


@pytest.fixture(scope="module")
def frame():
    return Frame.of(synthetic.clip("motion").frames[0])


def target_of(config=DEFAULT, base_size=(40.0, 40.0), grey=False):
    """At 40×40 the window takes 100×100: a pixel of the patch is one of the image."""
    target = Target(config, base_size, grey)
    target.center = PLACE
    return target


def beside(pixels_x, pixels_y):
    return PLACE[0] + pixels_x, PLACE[1] + pixels_y


# --- windows in a cut ---


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("by", [(0, 0), (5, -3), (-12, 12), (12, 12)])
def test_a_window_within_the_margin_is_a_slice_of_the_cut(frame, by, grey):
    target = target_of(grey=grey)
    cut = target.observe(frame, WITHIN, PLACE).cut
    seen = target.observe(frame, WITHIN, beside(*by), cut)
    assert seen.cut is cut
    assert seen.moved == by
    part = (slice(MARGIN + by[1], MARGIN + by[1] + 100), slice(MARGIN + by[0], MARGIN + by[0] + 100))
    assert np.array_equal(seen.bins, cut.bins[part])
    pixels, gray = np.ascontiguousarray(cut.pixels[part]), np.ascontiguousarray(cut.gray[part])
    assert np.array_equal(seen.spectra, target.template.spectra(pixels, gray))


@pytest.mark.parametrize("by", [(0, 0), (7, -3), (-12, 12)])
def test_a_window_moved_by_whole_pixels_shows_what_one_cut_there_does(frame, by):
    target = target_of()
    moved = target.observe(frame, WITHIN, beside(*by), target.observe(frame, WITHIN, PLACE).cut)
    anew = target.observe(frame, WITHIN, beside(*by))
    assert anew.moved == (0, 0)
    assert np.array_equal(moved.bins, anew.bins)
    assert np.array_equal(moved.spectra, anew.spectra)
    assert moved.displaced((0, 0)) == anew.displaced((0, 0)) == beside(*by)


def test_a_cut_holds_each_pixel_as_the_models_want_it(frame):
    for grey in (False, True):
        cut = target_of(grey=grey).observe(frame, WITHIN, PLACE).cut
        assert cut.scale == 1
        assert cut.patch.rect == (98, 58, 124, 124)
        shown = frame.image[58:182, 98:222]
        assert np.array_equal(cut.patch.pixels, shown)
        gray = cv2.cvtColor(shown, cv2.COLOR_BGR2GRAY)
        assert np.array_equal(cut.pixels, gray if grey else shown)
        assert np.array_equal(cut.gray, gray)
        assert cut.bins.shape == (124, 124)


def test_where_there_is_no_model_there_is_nothing(frame):
    seen = target_of(DEFAULT.replace(color_histogram=False)).observe(frame, WITHIN, PLACE)
    assert seen.bins.size == 0
    assert seen.spectra.size > 0
    seen = target_of(DEFAULT.replace(features=())).observe(frame, WITHIN, PLACE)
    assert seen.spectra.size == 0
    assert seen.bins.shape == (100, 100)


# --- when a cut is used again ---


@pytest.mark.parametrize(
    ("by", "scale", "again"),
    [
        ((0, 0), 1.0, True),
        ((12, -12), 1.0, True),
        ((12.01, 0), 1.0, False),
        ((0, -13), 1.0, False),
        ((3, 4), 1.02, True),
        ((3, 4), 1 / 1.02, True),
        ((0, 0), 1.02**2, False),
        ((0, 0), 1.02**-2, False),
        ((0, 0), 1.021, False),
    ],
)
def test_a_cut_serves_places_within_its_margin_and_a_step_of_scale(frame, by, scale, again):
    target = target_of()
    first = target.observe(frame, WITHIN, PLACE)
    target.scale = scale
    seen = target.observe(frame, WITHIN, beside(*by), first.cut)
    assert (seen.cut is first.cut) == again
    if not again:
        assert seen.cut.scale == scale
        anew = target.observe(frame, WITHIN, beside(*by))
        assert seen.moved == anew.moved
        assert np.array_equal(seen.spectra, anew.spectra)
        assert np.array_equal(seen.bins, anew.bins)


@pytest.mark.parametrize("config", [ANEW, MFCMTConfig.paper()])
@pytest.mark.parametrize(
    ("by", "scale", "again"),
    [
        ((0, 0), 1.0, True),
        ((0.3, -0.3), 1.0, True),  # the same whole pixels
        ((1, 0), 1.0, False),
        ((0, -1), 1.0, False),
        ((0, 0), 1.02, False),
        ((0, 0), 1 / 1.02, False),
    ],
)
def test_without_a_margin_every_window_is_cut_anew(frame, config, by, scale, again):
    """Unless it would be the same pixels."""
    target = target_of(config)
    first = target.observe(frame, WITHIN, PLACE)
    assert first.cut.pixels.shape[:2] == (config.patch_size, config.patch_size)
    target.scale = scale
    seen = target.observe(frame, WITHIN, beside(*by), first.cut)
    assert (seen.cut is first.cut) == again
    assert seen.moved == (0, 0)
    target.center = beside(*by)
    assert target.is_near(first) == again
    anew = target.observe(frame, WITHIN, beside(*by))
    assert np.array_equal(seen.spectra, anew.spectra)
    assert np.array_equal(seen.bins, anew.bins)


# --- places ---


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(list(CONFIGS)),
    st.tuples(st.floats(-8, 8), st.floats(-8, 8)),
    st.tuples(st.floats(-14, 14), st.floats(-14, 14)),
    st.tuples(st.floats(8, 90), st.floats(8, 90)),
    st.floats(0.5, 2),
)
def test_displaced_and_offset_are_inverse(frame, name, displacement, by, base_size, scale):
    target = target_of(CONFIGS[name], base_size)
    target.scale = scale
    seen = target.observe(frame, WITHIN, beside(*by), target.observe(frame, WITHIN, PLACE).cut)
    assert seen.offset(seen.displaced(displacement)) == pytest.approx(displacement, abs=1e-9)
    # the window is where it was asked for to half a pixel of the patch, or of the image where it was cut anew
    (x, y), step = seen.displaced((0, 0)), seen.cut.patch.step
    assert abs(x - PLACE[0] - by[0]) <= max(0.5, step[0] / 2) + 1e-9
    assert abs(y - PLACE[1] - by[1]) <= max(0.5, step[1] / 2) + 1e-9
    assert seen.is_central(seen.displaced((0.99, -0.99)))
    assert not seen.is_central(seen.displaced((0, 1.01)))


@pytest.mark.parametrize("learn_within", [0.5, 1.0, 2.5])
def test_models_learn_from_a_window_that_is_near(frame, learn_within):
    target = target_of(DEFAULT.replace(learn_within=learn_within))
    seen = target.observe(frame, WITHIN, beside(3, 5), target.observe(frame, WITHIN, PLACE).cut)
    for sign in ((1, 1), (-1, 1), (0, -1)):
        target.center = seen.displaced((sign[0] * 0.99 * learn_within, sign[1] * 0.99 * learn_within))
        assert target.is_near(seen)
        target.center = seen.displaced((sign[0] * learn_within, sign[1] * 1.01 * learn_within))
        assert not target.is_near(seen)
    target.center = seen.displaced((0, 0))
    for scale, near in ((1.02, True), (1 / 1.02, True), (1.02**2, False), (1.02**-2, False)):
        target.scale = scale
        assert target.is_near(seen) == near


def test_the_models_are_told_where_the_target_is(frame):
    """A cell to the right and two up: the same pixels are foreground as in a window around the target."""
    target, other = (target_of(DEFAULT.replace(learn_within=2.0)) for _ in range(2))
    target.center = beside(4, -8)
    target.learn(target.observe(frame, WITHIN, PLACE), first=True)
    other.learn(other.observe(frame, WITHIN, PLACE), first=True)
    around = other.observe(frame, WITHIN, beside(4, -8))
    assert not np.array_equal(target.color.histograms[:, 0], other.color.histograms[:, 0])
    other.center = beside(4, -8)
    other.learn(around, first=True)
    assert np.array_equal(target.color.histograms[:, 0], other.color.histograms[:, 0])
    # and a window around the target answers with its middle
    responses, _ = target.maps()
    target.template.respond(around.spectra, responses[:2])
    middle = tuple(reversed(target.window.reach))
    assert np.unravel_index(responses[0].argmax(), responses[0].shape) == middle
    assert np.unravel_index(responses[1].argmax(), responses[1].shape) == middle


def test_without_a_margin_the_target_counts_as_in_the_middle(frame):
    """As the paper has it: the place of the cut is rounded to whole pixels, and no more is said."""
    target, other = target_of(ANEW), target_of(ANEW)
    target.center = beside(0.3, -0.4)
    for each in (target, other):
        each.learn(each.observe(frame, WITHIN, each.center), first=True)
    assert np.array_equal(target.template.mean, other.template.mean)
    assert np.array_equal(target.color.histograms, other.color.histograms)


# --- channels ---


def test_grey_is_what_differs_by_no_more_than_rounding():
    gray = np.random.default_rng(0).integers(1, 255, (20, 30), np.uint8)
    three = np.repeat(gray[..., None], 3, axis=2)
    assert is_grey(gray)
    assert is_grey(three)
    for by, grey in ((1, True), (2, False)):
        changed = np.clip(three, 0, 250)
        changed[5, 5, 2] += by
        assert is_grey(changed) == grey


def test_pixels_come_in_the_channels_of_the_models():
    color = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    gray = as_mode(color, grey=True)
    assert np.array_equal(gray, cv2.cvtColor(color, cv2.COLOR_BGR2GRAY))
    assert as_mode(gray, grey=True) is gray
    assert as_mode(color, grey=False) is color
    assert np.array_equal(as_mode(gray, grey=False), np.repeat(gray[..., None], 3, axis=2))
