"""The kernels of the scale filter, each with its numpy twin."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core.kernels import scale

from . import reference
from .twins import close, complex_noise, patch_of

LANES = 24
WINDOW = np.pad(np.hanning(19)[1:-1], (0, 7)).astype(np.float32)
"""Of 17 scales; the other lanes are padding."""


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


def gradients_of(samples):
    magnitude, orientation = np.full(samples.shape, np.nan, np.float32), np.full(samples.shape, 255, np.uint8)
    scale.scale_gradients(samples, magnitude, orientation)
    return magnitude, orientation


def test_scale_gradients(samples):
    magnitude, orientation = gradients_of(samples)
    expected, along = reference.scale_gradients(samples)
    close(magnitude, expected)
    assert (orientation < 18).all()
    # where two directions fit equally, either will do
    chosen = np.take_along_axis(along, orientation[None].astype(np.int64), 0)[0]
    np.testing.assert_allclose(chosen, along.max(0), atol=1e-3)


def histogram_of(samples):
    histogram = np.full((6 * 4 + 1, 18, LANES), np.nan, np.float32)
    scale.scale_histogram(*gradients_of(samples), histogram)
    return histogram


def cells_of(histogram):
    """Return the histogram without the cell for votes outside, as in the twins: (cells_y, 18, cells_x, lanes)."""
    return np.moveaxis(histogram[:-1].reshape(6, 4, 18, LANES), 1, 2)


def test_scale_histogram(samples):
    expected = reference.scale_histogram(*gradients_of(samples))
    np.testing.assert_allclose(cells_of(histogram_of(samples)), expected, rtol=1e-4, atol=2e-2)


def features_of(histogram, epsilon, window):
    norms, energy = np.full((7, 5, LANES), np.nan, np.float32), np.full((6, 4, LANES), np.nan, np.float32)
    texture, out = np.full((4, LANES), np.nan, np.float32), np.full((6 * 4, 31, LANES), np.nan, np.float32)
    scale.scale_norms(histogram, np.float32(epsilon), energy, norms)
    scale.scale_features(histogram, norms, window, texture, out)
    return out


@pytest.mark.parametrize("epsilon", [1e-2, 10.0])
def test_scale_features(samples, epsilon):
    histogram = histogram_of(samples)
    out = features_of(histogram, epsilon, WINDOW)
    np.testing.assert_allclose(out, reference.scale_features(cells_of(histogram), epsilon, WINDOW), atol=1e-3)
    assert not out[..., 17:].any()


def test_scale_hog(gray):
    """One call equals the calls of its parts."""
    cut = patch_of(gray, 60, 80)
    step = np.linspace(0.8, 3.2, LANES, dtype=np.float32)
    epsilon, center = np.float32(10), (np.float32(39.3), np.float32(31.7))
    quads, orientation = np.empty((60, 80), np.uint32), np.empty((24, 16, LANES), np.uint8)
    samples, magnitude = np.empty((2, 24, 16, LANES), np.float32)
    histogram, energy = np.empty((25, 18, LANES), np.float32), np.empty((6, 4, LANES), np.float32)
    norms, texture = np.empty((7, 5, LANES), np.float32), np.empty((4, LANES), np.float32)
    out = np.full((6 * 4, 31, LANES), np.nan, np.float32)
    scratch = (quads, samples, magnitude, orientation, histogram, energy, norms, texture)
    scale.scale_hog(cut, *center, step, step, epsilon, WINDOW, *scratch, out)
    assert np.array_equal(quads, quads_of(cut))
    np.testing.assert_allclose(samples, reference.sample_scales(cut, 39.3, 31.7, step, step, (24, 16)), atol=0.02)
    assert np.array_equal(histogram, histogram_of(samples))
    np.testing.assert_allclose(out, features_of(histogram, epsilon, WINDOW), atol=1e-5)


@pytest.fixture
def filter_and_spectra():
    """Return half spectra along scales and a mean of such, (cells, 31, half) each, and their energy."""
    rng = np.random.default_rng(10)
    return complex_noise(rng, 6, 31, 8), complex_noise(rng, 6, 31, 8), rng.random(8).astype(np.float32)


def scratch_of(spectra, dtype):
    return np.full(spectra.shape[1:], np.nan, dtype)


def test_respond_scales(filter_and_spectra):
    spectra, mean, energy = filter_and_spectra
    label_f = np.random.default_rng(11).random(8).astype(np.float32)
    response_f = np.full(8, np.nan, np.complex64)
    products = scratch_of(spectra, np.complex64)
    scale.respond_scales(spectra, mean, label_f, energy, np.float32(0.3), products, response_f)
    close(response_f, reference.respond_scales(spectra, mean, label_f, energy, 0.3), 1e-4)


@pytest.mark.parametrize("angle", [0.0, 0.7])
@pytest.mark.parametrize("rate", [0.025, 1.0])
def test_learn_scales(filter_and_spectra, rate, angle):
    spectra, mean, energy = filter_and_spectra
    angles = (angle * np.arange(8)).astype(np.float32)
    expected = reference.learn_scales(spectra, np.exp(1j * angles), rate, mean, energy)
    turns, squares = scratch_of(spectra, np.complex64), scratch_of(spectra, np.float32)
    scale.learn_scales(spectra, angles, np.float32(rate), mean, energy, turns, squares)
    close(mean, expected[0])
    close(energy, expected[1])
