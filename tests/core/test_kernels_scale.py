"""The kernels of the scale filter, each with its numpy twin."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core.kernels import scale

from . import reference
from .twins import close, patch_of

LANES = 24
"""Eight smaller scales, eight larger ones, padding."""
PRESENT = [16, 7]
"""The lane of the present scale: behind all others, or in the padding of seven smaller ones."""


def quads_of(gray):
    quads = np.empty(gray.shape, np.uint32)
    scale.pack_quads(gray, quads)
    return quads


def test_pack_quads(gray):
    cut = patch_of(gray, 60, 81)
    assert np.array_equal(quads_of(cut).view(np.uint8).reshape(60, 81, 4), reference.pack_quads(cut))


def test_sample_scales(gray):
    cut = patch_of(gray, 60, 80)
    step_x, step_y = np.linspace(0.8, 3.2, 8, dtype=np.float32), np.linspace(0.5, 2.1, 8, dtype=np.float32)
    out = np.empty((24, 32, 8), np.float32)
    scale.sample_scales(quads_of(cut), np.float32(39.3), np.float32(31.7), step_x, step_y, out)
    np.testing.assert_allclose(out, reference.sample_scales(cut, 39.3, 31.7, step_x, step_y, (24, 32)), atol=0.02)


@pytest.fixture
def samples(gray):
    """(24, 16, LANES)"""
    steps = np.linspace(0.7, 1.4, LANES, dtype=np.float32)
    made = reference.sample_scales(gray, 90.2, 80.6, steps, steps, (24, 16)).astype(np.float32)
    return made + np.random.default_rng(0).random(made.shape).astype(np.float32)  # no ties between directions


def histogram_of(samples, count):
    histogram = np.full((6 * 4 + 1, 18, LANES), np.nan, np.float32)
    scale.scale_histogram(samples, count, histogram)
    return histogram


def test_scale_histogram(samples):
    histogram = histogram_of(samples, 17)
    cells_ = np.moveaxis(histogram[:-1].reshape(6, 4, 18, LANES), 1, 2)
    np.testing.assert_allclose(cells_[..., :17], reference.scale_histogram(samples[..., :17]), rtol=1e-4, atol=2e-2)
    assert not cells_[..., 17:].any()


def window_of(present):
    """Weights of the scales, those of the padding 0; what faces the present one is padding, too."""
    window = np.zeros(LANES, np.float32)
    window[:8] = window[8:16] = np.linspace(1, 0.1, 8)
    window[8 + present :] = 0
    window[present] = 1
    return window


@pytest.mark.parametrize("present", PRESENT)
@pytest.mark.parametrize("epsilon", [1e-2, 10.0])
def test_scale_features(samples, epsilon, present):
    histogram = histogram_of(samples, 17)
    window = window_of(present)
    norms = np.full((7, 5, LANES), np.nan, np.float32)
    even, odd = np.full((6 * 4 * 31, 9), np.nan, np.float32), np.full((6 * 4 * 31, 8), np.nan, np.float32)
    scale.scale_norms(histogram, np.float32(epsilon), norms)
    scale.scale_features(histogram, norms, window, present, even, odd)
    cells_ = np.moveaxis(histogram[:-1].reshape(6, 4, 18, LANES), 1, 2)
    expected = reference.fold(reference.scale_features(cells_, epsilon, window), 8, present)
    np.testing.assert_allclose(even, expected[0], atol=1e-3)
    np.testing.assert_allclose(odd, expected[1], atol=1e-3)


@pytest.mark.parametrize("present", PRESENT)
def test_scale_hog(gray, present):
    """The parts in one call."""
    cut = patch_of(gray, 60, 80)
    step = np.linspace(0.8, 3.2, LANES, dtype=np.float32)
    window, epsilon, center = np.ones(LANES, np.float32), np.float32(10), (np.float32(39.3), np.float32(31.7))
    samples, histogram = np.empty((24, 16, LANES), np.float32), np.empty((25, 18, LANES), np.float32)
    quads, norms = np.empty((60, 80), np.uint32), np.empty((7, 5, LANES), np.float32)
    even, odd = np.empty((24 * 31, 9), np.float32), np.empty((24 * 31, 8), np.float32)
    scale.scale_hog(cut, *center, step, step, present, epsilon, window, quads, samples, histogram, norms, even, odd)
    assert np.array_equal(quads, quads_of(cut))
    np.testing.assert_allclose(samples, reference.sample_scales(cut, 39.3, 31.7, step, step, (24, 16)), atol=0.02)
    assert np.array_equal(histogram, histogram_of(samples, max(present + 1, 16)))
    expected_even, expected_odd = np.empty_like(even), np.empty_like(odd)
    scale.scale_features(histogram, norms, window, present, expected_even, expected_odd)
    np.testing.assert_allclose(even, expected_even, atol=1e-5)
    np.testing.assert_allclose(odd, expected_odd, atol=1e-5)


@pytest.mark.parametrize("present", PRESENT)
def test_fold(present):
    values = np.random.default_rng(11).random(LANES).astype(np.float32)
    even, odd = np.empty(9, np.float32), np.empty(8, np.float32)
    scale.fold(values, present, even, odd)
    for actual, expected in zip((even, odd), reference.fold(values, 8, present), strict=True):
        close(actual, expected)


@pytest.fixture
def filter_and_spectra():
    """Waves and sums of spectra and of a mean, (50, 16) and (50,) each."""
    rng = np.random.default_rng(10)
    waves, mean = rng.standard_normal((2, 50, 16)).astype(np.float32)
    sums, mean_sums = rng.standard_normal((2, 50)).astype(np.float32)
    return waves, sums, mean, mean_sums


def test_respond_scales(filter_and_spectra):
    waves, sums, mean, mean_sums = filter_and_spectra
    label_f, energy = np.random.default_rng(11).random((2, 9)).astype(np.float32)
    response_f = np.empty(17, np.float32)
    scale.respond_scales(waves, sums, mean, mean_sums, label_f, energy, np.float32(0.3), response_f)
    complex_, complex_mean = reference.complex_scales(waves, sums), reference.complex_scales(mean, mean_sums)
    expected = reference.respond_scales(complex_, complex_mean, np.roll(label_f, 1), np.roll(energy, 1), 0.3)
    close(reference.complex_scales(response_f[None, :16], response_f[16:])[0], expected, 1e-4)


@pytest.mark.parametrize("angle", [0.0, 0.7])
@pytest.mark.parametrize("rate", [0.025, 1.0])
def test_learn_scales(filter_and_spectra, rate, angle):
    waves, sums, mean, mean_sums = filter_and_spectra
    energy = np.random.default_rng(12).random(9).astype(np.float32)
    angles = (angle * np.arange(1, 9)).astype(np.float32)
    complex_, complex_mean = reference.complex_scales(waves, sums), reference.complex_scales(mean, mean_sums)
    expected = reference.learn_scales(complex_, angles, rate, complex_mean, np.roll(energy, 1))
    scale.learn_scales(waves, sums, angles, np.float32(rate), mean, mean_sums, energy)
    close(reference.complex_scales(mean, mean_sums), expected[0])
    close(np.roll(energy, 1), expected[1])
