"""What the models of one target see of a frame: one cut, and windows in it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMTConfig, synthetic
from mfcmt_core.geometry import Frame
from mfcmt_core.target import Target, convert_channels, is_gray

DEFAULT = MFCMTConfig.default()
ANEW = DEFAULT.replace(learn_within=0.0)
CONFIGS = {"default": DEFAULT, "anew": ANEW, "paper": MFCMTConfig.paper()}
PLACE = (160.0, 120.0)
READABLE = (0, 0, 320, 240)
MARGIN = 12


@pytest.fixture(scope="module")
def frame():
    return Frame.of(synthetic.clip("motion").frames[0])


def target_of(config=DEFAULT, base_size=(40.0, 40.0), is_gray=False):
    """Return a target. At 40×40 its window takes 100×100 pixels, so that a pixel of the patch is one of the image."""
    target = Target(config, base_size, is_gray)
    target.center = PLACE
    return target


def beside(pixels_x, pixels_y):
    return PLACE[0] + pixels_x, PLACE[1] + pixels_y


# --- windows in a cut ---


@pytest.mark.parametrize("is_gray", [False, True])
@pytest.mark.parametrize("by", [(0, 0), (5, -3), (-12, 12), (12, 12)])
def test_a_window_within_the_margin_is_a_slice_of_the_crop(frame, by, is_gray):
    target = target_of(is_gray=is_gray)
    crop = target.observe(frame, READABLE, PLACE).crop
    observation = target.observe(frame, READABLE, beside(*by), crop)
    assert observation.crop is crop
    assert observation.shift == by
    part = (slice(MARGIN + by[1], MARGIN + by[1] + 100), slice(MARGIN + by[0], MARGIN + by[0] + 100))
    assert np.array_equal(observation.bins, crop.bins[part])
    pixels, gray = np.ascontiguousarray(crop.pixels[part]), np.ascontiguousarray(crop.gray[part])
    assert np.array_equal(observation.spectra, target.template.spectra(pixels, gray))


@pytest.mark.parametrize("by", [(0, 0), (7, -3), (-12, 12)])
def test_a_shifted_window_shows_what_a_new_crop_there_does(frame, by):
    target = target_of()
    shifted = target.observe(frame, READABLE, beside(*by), target.observe(frame, READABLE, PLACE).crop)
    anew = target.observe(frame, READABLE, beside(*by))
    assert anew.shift == (0, 0)
    assert np.array_equal(shifted.bins, anew.bins)
    assert np.array_equal(shifted.spectra, anew.spectra)
    assert shifted.place_at((0, 0)) == anew.place_at((0, 0)) == beside(*by)


def test_a_crop_has_the_channels_of_the_models(frame):
    for gray_target in (False, True):
        crop = target_of(is_gray=gray_target).observe(frame, READABLE, PLACE).crop
        assert crop.scale == 1
        assert crop.patch.rect == (98, 58, 124, 124)
        shown = frame.image[58:182, 98:222]
        assert np.array_equal(crop.patch.pixels, shown)
        gray = cv2.cvtColor(shown, cv2.COLOR_BGR2GRAY)
        assert np.array_equal(crop.pixels, gray if gray_target else shown)
        assert np.array_equal(crop.gray, gray)
        assert crop.bins.shape == (124, 124)


def test_an_observation_is_empty_without_a_model(frame):
    observation = target_of(DEFAULT.replace(color_histogram=False)).observe(frame, READABLE, PLACE)
    assert observation.bins.size == 0
    assert observation.spectra.size > 0
    observation = target_of(DEFAULT.replace(features=())).observe(frame, READABLE, PLACE)
    assert observation.spectra.size == 0
    assert observation.bins.shape == (100, 100)


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
def test_a_crop_is_reused_within_its_margin_and_a_step_of_scale(frame, by, scale, again):
    target = target_of()
    first = target.observe(frame, READABLE, PLACE)
    target.scale = scale
    observation = target.observe(frame, READABLE, beside(*by), first.crop)
    assert (observation.crop is first.crop) == again
    if not again:
        assert observation.crop.scale == scale
        anew = target.observe(frame, READABLE, beside(*by))
        assert observation.shift == anew.shift
        assert np.array_equal(observation.spectra, anew.spectra)
        assert np.array_equal(observation.bins, anew.bins)


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
def test_without_a_margin_every_window_is_a_new_crop(frame, config, by, scale, again):
    """The crop is reused only for the very same pixels."""
    target = target_of(config)
    first = target.observe(frame, READABLE, PLACE)
    assert first.crop.pixels.shape[:2] == (config.patch_size, config.patch_size)
    target.scale = scale
    observation = target.observe(frame, READABLE, beside(*by), first.crop)
    assert (observation.crop is first.crop) == again
    assert observation.shift == (0, 0)
    target.center = beside(*by)
    assert target.can_learn_from(first) == again
    anew = target.observe(frame, READABLE, beside(*by))
    assert np.array_equal(observation.spectra, anew.spectra)
    assert np.array_equal(observation.bins, anew.bins)


# --- places ---


@settings(max_examples=100)
@given(
    st.sampled_from(list(CONFIGS)),
    st.tuples(st.floats(-8, 8), st.floats(-8, 8)),
    st.tuples(st.floats(-14, 14), st.floats(-14, 14)),
    st.tuples(st.floats(8, 90), st.floats(8, 90)),
    st.floats(0.5, 2),
)
def test_place_at_and_offset_are_inverse(frame, name, displacement, by, base_size, scale):
    target = target_of(CONFIGS[name], base_size)
    target.scale = scale
    observation = target.observe(frame, READABLE, beside(*by), target.observe(frame, READABLE, PLACE).crop)
    assert observation.offset(observation.place_at(displacement)) == pytest.approx(displacement, abs=1e-9)
    # the window is where it was asked for to half a pixel of the patch, or of the image where it was cut anew
    (x, y), step = observation.place_at((0, 0)), observation.crop.patch.step
    assert abs(x - PLACE[0] - by[0]) <= max(0.5, step[0] / 2) + 1e-9
    assert abs(y - PLACE[1] - by[1]) <= max(0.5, step[1] / 2) + 1e-9
    assert observation.is_central(observation.place_at((0.99, -0.99)))
    assert not observation.is_central(observation.place_at((0, 1.01)))


@pytest.mark.parametrize("learn_within", [0.5, 1.0, 2.5])
def test_models_learn_from_a_window_that_is_near(frame, learn_within):
    target = target_of(DEFAULT.replace(learn_within=learn_within))
    observation = target.observe(frame, READABLE, beside(3, 5), target.observe(frame, READABLE, PLACE).crop)
    for sign in ((1, 1), (-1, 1), (0, -1)):
        target.center = observation.place_at((sign[0] * 0.99 * learn_within, sign[1] * 0.99 * learn_within))
        assert target.can_learn_from(observation)
        target.center = observation.place_at((sign[0] * learn_within, sign[1] * 1.01 * learn_within))
        assert not target.can_learn_from(observation)
    target.center = observation.place_at((0, 0))
    for scale, near in ((1.02, True), (1 / 1.02, True), (1.02**2, False), (1.02**-2, False)):
        target.scale = scale
        assert target.can_learn_from(observation) == near


def test_the_models_learn_the_target_at_its_place_in_the_window(frame):
    """A window off the target has the same foreground pixels as a window around it."""
    target, other = (target_of(DEFAULT.replace(learn_within=2.0)) for _ in range(2))
    target.center = beside(4, -8)
    target.learn(target.observe(frame, READABLE, PLACE), first=True)
    other.learn(other.observe(frame, READABLE, PLACE), first=True)
    around = other.observe(frame, READABLE, beside(4, -8))
    assert not np.array_equal(target.color.histograms[:, 0], other.color.histograms[:, 0])
    other.center = beside(4, -8)
    other.learn(around, first=True)
    assert np.array_equal(target.color.histograms[:, 0], other.color.histograms[:, 0])
    # and a window around the target answers with its middle
    responses, _ = target.maps()
    target.template.respond(around.spectra, responses[:2])
    middle = tuple(reversed(target.search_window.reach))
    assert np.unravel_index(responses[0].argmax(), responses[0].shape) == middle
    assert np.unravel_index(responses[1].argmax(), responses[1].shape) == middle


def test_without_a_margin_the_target_is_learned_in_the_middle(frame):
    """As in the paper, the place is rounded to whole pixels and the rest ignored."""
    target, other = target_of(ANEW), target_of(ANEW)
    target.center = beside(0.3, -0.4)
    for each in (target, other):
        each.learn(each.observe(frame, READABLE, each.center), first=True)
    assert np.array_equal(target.template.numerator, other.template.numerator)
    assert np.array_equal(target.color.histograms, other.color.histograms)


# --- channels ---


def test_channels_that_differ_by_rounding_are_gray():
    gray = np.random.default_rng(0).integers(1, 255, (20, 30), np.uint8)
    three = np.repeat(gray[..., None], 3, axis=2)
    assert is_gray(gray)
    assert is_gray(three)
    for by, expected in ((1, True), (2, False)):
        changed = np.clip(three, 0, 250)
        changed[5, 5, 2] += by
        assert is_gray(changed) == expected


def test_pixels_are_converted_to_the_channels_of_the_models():
    color = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    gray = convert_channels(color, to_gray=True)
    assert np.array_equal(gray, cv2.cvtColor(color, cv2.COLOR_BGR2GRAY))
    assert convert_channels(gray, to_gray=True) is gray
    assert convert_channels(color, to_gray=False) is color
    assert np.array_equal(convert_channels(gray, to_gray=False), np.repeat(gray[..., None], 3, axis=2))
