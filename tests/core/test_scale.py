"""The scale filter: a regression along sizes that finds by which factor a target grew."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMTConfig, synthetic
from mfcmt_core.geometry import Frame
from mfcmt_core.kernels.scale import respond_scales
from mfcmt_core.scale import ScaleModel

CONFIG = MFCMTConfig.default()
SIZE = (320, 240)
WITHIN = (0, 0, *SIZE)
CENTER = (162.0, 121.0)
SAMPLES = [15, 33]
"""Scales sampled of the 33: some, and all."""


@pytest.fixture(scope="module")
def image():
    return synthetic.clip("sample", target=(60.0, 80.0)).frames[0][120:360, 160:480].copy()


def zoomed(image, factor, center=CENTER):
    """Return the picture enlarged around ``center`` (continuous coordinates)."""
    x, y = center[0] - 0.5, center[1] - 0.5
    matrix = np.array([[factor, 0, x * (1 - factor)], [0, factor, y * (1 - factor)]])
    return cv2.warpAffine(image, matrix, SIZE, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def spectra(model, image, scale=1.0, center=CENTER):
    return model.spectra(Frame.of(image), WITHIN, center, scale).copy()


def along_scales(spectra, count):
    """Invert half spectra along the last axis: ``count`` scales, the present one in the middle."""
    return np.fft.fftshift(np.fft.irfft(spectra, count), axes=-1)


def learned(image, base_size=(70.0, 60.0), **changes):
    model = ScaleModel(CONFIG.replace(**changes), base_size)
    model.learn(spectra(model, image), first=True)
    return model


@pytest.mark.parametrize("samples", SAMPLES)
@pytest.mark.parametrize("steps", [-9, -5, -2, -1, 0, 1, 2, 5, 9])
def test_known_scale_factors_are_recovered(image, steps, samples):
    factor = 1.02**steps
    model = learned(image, scale_samples=samples)
    found = model.estimate(spectra(model, zoomed(image, factor)))
    assert abs(np.log(found / factor) / np.log(1.02)) <= 1.01


def test_the_present_scale_is_taken_into_account(image):
    """A target at 1.2 times its first size, sampled at scale 1.2, has not changed."""
    model = learned(image)
    assert model.estimate(spectra(model, zoomed(image, 1.2), scale=1.2)) == pytest.approx(1, abs=0.021)


@pytest.mark.parametrize(("count", "apart"), [(15, (0, 1, 2, 5)), (33, (0, 1, 4, 12))])
def test_spectra_are_the_dft_over_scales(image, count, apart):
    """The inverse returns windowed features in [0, 1]; the nearer the scales, the more similar."""
    model = learned(image, scale_samples=count)
    seen = spectra(model, image)
    assert seen.dtype == np.complex64
    assert not seen[..., 0].imag.any()
    samples = along_scales(seen, model.count)
    assert samples.shape == (model.width * model.height // 16, 31, count)
    assert samples.min() > -1e-4
    assert samples.max() <= 1
    features, same = samples / np.hanning(count + 2)[1:-1], count // 2
    likeness = [np.corrcoef(features[..., same].flat, features[..., same + k].flat)[0, 1] for k in apart]
    assert likeness == sorted(likeness, reverse=True)


@pytest.mark.parametrize("count", SAMPLES)
def test_samples_show_the_target_at_their_scales(image, count):
    """Smaller scales come first; each sample equals the present one of a target of that size."""
    model = learned(image, scale_samples=count)
    window, same = np.hanning(count + 2)[1:-1], count // 2
    seen = along_scales(spectra(model, image), count) / window
    for step in (-same // 2, -1, 1, same // 2):
        there = along_scales(spectra(model, image, model.lane_factors[same + step]), count) / window
        likeness = [np.corrcoef(there[..., same].flat, seen[..., k].flat)[0, 1] for k in range(count)]
        assert np.argmax(likeness) == same + step


@pytest.mark.parametrize("samples", SAMPLES)
def test_filter_is_the_regression_along_scales(image, samples):
    """It equals the dense solution, for one feature, of min ‖w ⋆ x - y‖² + λ‖w‖² over circular shifts of scales."""
    model = learned(image, scale_samples=samples)
    n = model.count
    assert n == samples
    seen = spectra(model, image)
    x = along_scales(seen, n)
    cell, channel = np.unravel_index(np.abs(x).sum(-1).argmax(), x.shape[:2])
    one = ScaleModel(CONFIG.replace(scale_samples=samples), (70.0, 60.0))
    one.numerator = np.zeros((1, 1, n // 2 + 1), np.complex64)
    one.learn(seen[cell, channel][None, None], first=True)
    shifts = np.stack([np.roll(x[cell, channel], -d) for d in range(n)])
    steps = (np.arange(n) - n // 2) * 33 / n
    label = np.exp(-0.5 * (steps / (np.sqrt(33) * CONFIG.scale_sigma_factor)) ** 2)
    penalty = CONFIG.scale_regularization
    w = np.linalg.solve(shifts.T @ shifts + penalty * np.eye(n), shifts.T @ label)
    w_f = one.label_f / (one.energy + penalty) * one.numerator[0, 0]
    np.testing.assert_allclose(along_scales(w_f, n), np.roll(w, n // 2), atol=1e-3)


def test_the_scale_filter_is_learned_with_its_rate(image):
    model = learned(image, scale_learning_rate=0.1)
    other = learned(zoomed(image, 1.1), scale_learning_rate=0.1)
    first, energy = model.numerator.copy(), model.energy.copy()
    model.learn(spectra(model, zoomed(image, 1.1)))
    np.testing.assert_allclose(model.numerator, 0.9 * first + 0.1 * other.numerator, atol=1e-3)
    np.testing.assert_allclose(model.energy, 0.9 * energy + 0.1 * other.energy, rtol=1e-4)


def test_scales_are_33_powers_of_the_step():
    model = ScaleModel(CONFIG.replace(scale_samples=33), (50.0, 50.0))
    np.testing.assert_allclose(model.factors, 1.02 ** np.arange(-16.0, 17), rtol=1e-6)
    np.testing.assert_allclose(model.lane_factors, [*(1.02 ** np.arange(-16.0, 17)), *[1] * 7], rtol=1e-6)
    assert model.largest == pytest.approx(1.02**16)
    assert model.hann[16] == 1
    assert not model.hann[33:].any()


def test_fifteen_samples_take_as_many_steps_as_33_scales():
    """Each sample is 33 / 15 of a step from the next; one lane is padding."""
    model = ScaleModel(CONFIG, (50.0, 50.0))
    np.testing.assert_allclose(model.factors, 1.02 ** np.arange(-16.0, 17), rtol=1e-6)
    step = 1.02 ** (33 / 15)
    np.testing.assert_allclose(model.lane_factors, [*(step ** np.arange(-7.0, 8)), 1], rtol=1e-6)
    assert model.hann[7] == 1
    assert model.hann[15] == 0
    assert model.largest == pytest.approx(step**7)


def response_f_of(model, seen):
    products, response_f = np.empty(seen.shape[1:], np.complex64), np.empty(seen.shape[-1], np.complex64)
    respond_scales(seen, model.numerator, model.label_f, model.energy, model.regularization, products, response_f)
    return response_f


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.13])
def test_between_the_samples_the_response_is_interpolated(image, factor):
    """Each sample counts times the kernel sin πt / (n sin πt/n), where t is its distance in samples."""
    model = learned(image)
    response_f = response_f_of(model, spectra(model, zoomed(image, factor)))
    at_samples = along_scales(response_f, 15)
    away = (np.arange(-16, 17) * 15 / 33)[:, None] - np.arange(-7, 8)
    with np.errstate(invalid="ignore"):
        kernel = np.sin(np.pi * away) / (15 * np.sin(np.pi * away / 15))
    kernel[np.isclose(away, 0)] = 1
    fine = kernel @ at_samples
    np.testing.assert_allclose(model.inverse @ response_f.view(np.float32), fine, atol=1e-4 * np.abs(fine).max())
    assert model.estimate(spectra(model, zoomed(image, factor))) == model.factors[fine.argmax()]


@pytest.mark.parametrize("samples", [33, 35, 101])
def test_nothing_is_interpolated_if_all_scales_are_sampled(image, samples):
    model = learned(image, scale_samples=samples)
    assert model.count == 33
    response_f = response_f_of(model, spectra(model, zoomed(image, 1.1)))
    expected = along_scales(response_f, 33)
    actual = model.inverse @ response_f.view(np.float32)
    np.testing.assert_allclose(actual, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("samples", SAMPLES)
@pytest.mark.parametrize("steps", [-3, -1, 0, 1, 2])
def test_a_grown_target_is_learned_as_if_sampled_at_its_size(image, steps, samples):
    """By whole steps between samples, the windowed features are rolled."""
    model, plain = (learned(image, scale_samples=samples) for _ in range(2))
    seen = spectra(model, zoomed(image, 1.1))
    sample_step = 1.02 ** (33 / samples)
    model.learn(seen, sample_step**steps, first=True)
    plain.learn(seen, first=True)
    expected = np.roll(along_scales(plain.numerator, samples), -steps, axis=-1)
    np.testing.assert_allclose(along_scales(model.numerator, samples), expected, atol=1e-4)
    np.testing.assert_allclose(model.energy, plain.energy, rtol=1e-4)


@pytest.mark.parametrize("samples", SAMPLES)
@pytest.mark.parametrize("growth", [1.02**-3, 1.02, 1.02**2])
def test_a_fraction_of_a_step_shifts_each_phase_by_its_frequency(image, growth, samples):
    model, plain = (learned(image, scale_samples=samples) for _ in range(2))
    seen = spectra(model, image)
    model.learn(seen, growth, first=True)
    plain.learn(seen, first=True)
    shift = np.log(growth) / (33 / samples * np.log(1.02))
    expected = plain.numerator * np.exp(2j * np.pi / samples * np.arange(samples // 2 + 1) * shift)
    np.testing.assert_allclose(model.numerator, expected, atol=1e-4)


@pytest.mark.parametrize("steps", [-2, -1, 1, 2])
def test_after_learning_growth_the_estimate_at_the_new_size_is_one(image, steps):
    """A target sampled at its old size and learned with its growth shows no change at its new size."""
    factor = 1.02**steps
    grown = zoomed(image, factor)
    model = ScaleModel(CONFIG, (70.0, 60.0))
    model.learn(spectra(model, grown), factor, first=True)
    assert model.estimate(spectra(model, grown, scale=factor)) == pytest.approx(1, abs=0.021)
    assert model.estimate(spectra(model, grown)) == pytest.approx(factor, abs=1e-6)


@pytest.mark.parametrize("samples", [15, 17, 35])
@pytest.mark.parametrize("scales", [17, 21, 35])
def test_other_numbers_of_scales_work(image, scales, samples):
    """Scales are padded to whole lanes, and the padding has no effect."""
    model = learned(image, num_scales=scales, scale_samples=samples, scale_step=1.04)
    assert model.estimate(spectra(model, image)) == 1
    assert model.estimate(spectra(model, zoomed(image, 1.04))) == pytest.approx(1.04)
    samples = along_scales(spectra(model, image), min(scales, samples))
    assert samples.min() > -1e-4
    assert samples.max() <= 1


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_flat_picture_keeps_the_size(image, value):
    flat = np.full_like(image, value)
    for model in (learned(image), learned(flat)):
        assert model.estimate(spectra(model, flat)) == 1


@settings(max_examples=100)
@given(st.floats(1e-3, 4000), st.floats(1e-3, 4000), st.floats(64, 4096))
def test_samples_are_at_most_as_large_as_configured(w, h, area):
    """They have the target's aspect to half a cell, and sides of 8 to 64 pixels even for the thinnest targets."""
    model = ScaleModel(CONFIG.replace(scale_max_area=area), (w, h))
    for side, exact in ((model.width, np.sqrt(area * w / h)), (model.height, np.sqrt(area * h / w))):
        assert side % 4 == 0
        assert side == pytest.approx(np.clip(exact, 8, 64), abs=2.001)


@settings(max_examples=100)
@given(st.floats(1e-3, 4000), st.floats(1e-3, 4000), st.floats(1e-6, 1e6))
def test_clamp_keeps_the_target_above_a_few_pixels_and_inside_the_frame(w, h, scale):
    model = ScaleModel(CONFIG.replace(scale_max_area=64), (w, h))
    kept = model.clamp(scale, (640, 480))
    if min(w, h) >= 5:
        assert min(w, h) * kept >= 5 * (1 - 1e-9)
    if w <= 640 and h <= 480:
        assert w * kept <= 640 * (1 + 1e-9)
        assert h * kept <= 480 * (1 + 1e-9)
    assert model.clamp(1.0, (640, 480)) == 1  # the box that was given is never refused
    assert model.clamp(kept, (640, 480)) == kept
