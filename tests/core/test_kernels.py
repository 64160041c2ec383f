"""Every numba kernel agrees with its numpy twin to float tolerance, on rendered, real, noisy and flat pixels."""

from __future__ import annotations

from pathlib import Path
from types import FunctionType

import cv2
import numba
import numpy as np
import pytest

from mfcmt_core.features import color_names, hann_window
from mfcmt_core.kernels import background, cells, color, fourier, fusion, hog, scale, template

from . import reference


def alone(part):
    """A compiled copy by another name, for a part of another kernel.

    The process would link the part itself, once it is loaded, into that kernel too, in place of the copy that was
    optimised there, and every later result would be rounded otherwise.
    """
    function = FunctionType(part.py_func.__code__, part.py_func.__globals__, f"{part.__name__}_alone")
    return numba.njit(fastmath=True, error_model="numpy")(function)


normalize_cells = alone(hog.normalize_cells)


def close(actual, expected, tolerance=2e-5):
    """Equal up to float32: relative to the largest value."""
    assert actual.shape == expected.shape
    np.testing.assert_allclose(actual, expected, rtol=1e-4, atol=tolerance * max(1e-6, np.abs(expected).max()))


def complex_noise(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def patch_of(image, height, width):
    return np.ascontiguousarray(image[20 : 20 + height, 30 : 30 + width])


# --- cells and fHOG ---


@pytest.mark.parametrize("n", [8, 25, 37])
def test_gray_cells(gray, n):
    out = np.full((n, 3, n), np.nan, np.float32)
    cells.gray_cells(patch_of(gray, 4 * n, 4 * n), hann_window(n), 1, out)
    close(out[:, 1], reference.gray_cells(patch_of(gray, 4 * n, 4 * n), hann_window(n)))
    assert np.isnan(out[:, [0, 2]]).all()


def test_color_name_cells(picture):
    table, n = color_names.table(), 25
    patch = patch_of(picture, 4 * n, 4 * n)
    out = np.full((n, 2 + table.shape[1], n), np.nan, np.float32)
    cells.color_name_cells(patch, table, hann_window(n), 2, out)
    close(np.moveaxis(out[:, 2:], 1, 0), reference.color_name_cells(patch, table, hann_window(n)))
    assert np.isnan(out[:, :2]).all()
    means = cv2.resize(patch, (n, n), interpolation=cv2.INTER_AREA)
    assert np.array_equal(out[:, 2:], np.moveaxis(table[reference.bin_pixels(means)], -1, 1) * hann_window(n)[:, None])


@pytest.mark.parametrize("shape", [(100, 100), (148, 148), (32, 60)])
def test_gradients(gray, shape):
    patch = patch_of(gray, *shape)
    magnitude, orientation = np.empty(shape, np.float32), np.empty(shape, np.uint8)
    hog.gradients(patch, magnitude, orientation)
    expected, along = reference.gradients(patch)
    close(magnitude, expected)
    assert (orientation < 18).all()
    # where two directions fit equally, either will do
    chosen = np.take_along_axis(along, orientation[None].astype(np.int64), 0)[0]
    np.testing.assert_allclose(chosen, along.max(0), atol=1e-3)
    assert (orientation[expected == 0] == 0).all()


@pytest.mark.parametrize("shape", [(100, 100), (148, 148), (32, 60)])
def test_histogram_cells(gray, shape):
    magnitude, orientation = np.empty(shape, np.float32), np.empty(shape, np.uint8)
    hog.gradients(patch_of(gray, *shape), magnitude, orientation)
    cells_y, cells_x = shape[0] // 4, shape[1] // 4
    histogram = np.full((cells_y, 18, cells_x), np.nan, np.float32)
    hog.histogram_cells(magnitude, orientation, np.full((4, 18, cells_x + 2), np.nan, np.float32), histogram)
    close(histogram, reference.histogram_cells(magnitude, orientation))


@pytest.mark.parametrize("epsilon", [1e-4, 10.0])
@pytest.mark.parametrize("shape", [(100, 100), (32, 60)])
def test_normalize_cells(gray, shape, epsilon):
    magnitude, orientation = np.empty(shape, np.float32), np.empty(shape, np.uint8)
    hog.gradients(patch_of(gray, *shape), magnitude, orientation)
    histogram = reference.histogram_cells(magnitude, orientation).astype(np.float32)
    cells_y, _, cells_x = histogram.shape
    window = np.random.default_rng(0).random((cells_y, cells_x)).astype(np.float32)
    out = np.full((cells_y, 1 + hog.CHANNELS, cells_x), np.nan, np.float32)
    norms = np.full((cells_y + 1, cells_x + 1), np.nan, np.float32)
    normalize_cells(histogram, window, np.float32(epsilon), norms, 1, out)
    close(np.moveaxis(out[:, 1:], 1, 0), reference.normalize_cells(histogram, window, epsilon))
    assert np.isnan(out[:, 0]).all()


@pytest.mark.parametrize("seed", range(4))
def test_direction(seed):
    dx, dy = np.random.default_rng(seed).integers(-255, 256, 2).astype(np.float32)
    along = reference.projections(float(dx), float(dy))
    assert along[hog.direction(dx, dy)] == pytest.approx(along.max())


def test_direction_of_every_quarter():
    for angle in np.arange(0, 360, 7.3):  # none half-way between two directions
        dx, dy = np.float32(np.cos(np.radians(angle))), np.float32(np.sin(np.radians(angle)))
        assert hog.direction(dx, dy) == round(angle / 20) % 18
    # on the axes and where there is nothing
    turns = [hog.direction(np.float32(x), np.float32(y)) for x, y in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1))]
    assert turns == [0, 0, 4, 9, 13]


def test_hog_cells(gray):
    """The parts in one call."""
    patch = patch_of(gray, 32, 60)
    window = np.random.default_rng(0).random((8, 15)).astype(np.float32)
    magnitude, orientation = np.empty((32, 60), np.float32), np.empty((32, 60), np.uint8)
    scratch = (np.empty((4, 18, 17), np.float32), np.empty((8, 18, 15), np.float32), np.empty((9, 16), np.float32))
    out, expected = np.zeros((2, 8, 32, 15), np.float32)
    hog.hog_cells(patch, window, np.float32(1), 1, magnitude, orientation, *scratch, out)
    normalize_cells(scratch[1], window, np.float32(1), scratch[2], 1, expected)
    close(out, expected)
    close(scratch[1], reference.histogram_cells(magnitude, orientation))


# --- colour ---


def test_bins(picture, gray):
    bins = np.empty(picture.shape[:2], np.uint16)
    color.bin_pixels(picture, bins)
    assert np.array_equal(bins, reference.bin_pixels(picture))
    color.bin_gray(gray, bins)
    assert np.array_equal(bins, reference.bin_gray(gray))


@pytest.mark.parametrize(
    ("inner", "outer"),
    [
        ((30, 20, 70, 60), (25, 15, 75, 65)),
        ((49, 49, 50, 50), (49, 49, 50, 50)),
        ((0, 0, 100, 100), (0, 0, 100, 100)),  # no background at all
        ((10, 48, 90, 52), (0, 45, 100, 55)),
    ],
)
@pytest.mark.parametrize("rate", [0.0, 0.04, 1.0])
def test_learn_colors(picture, inner, outer, rate):
    bins = reference.bin_pixels(patch_of(picture, 100, 100)).astype(np.uint16)
    f, b = (np.random.default_rng(1).random((2, 32**3)) / 1000).astype(np.float32)
    expected = reference.learn_colors(bins, inner, outer, rate, f, b)
    counts = np.zeros((2, 32**3), np.int32)
    color.learn_colors(bins, inner, outer, np.float32(rate), counts, f, b)
    assert not counts.any()
    for actual, wanted in zip((f, b), expected, strict=True):
        close(actual, wanted)


def test_colours_fade_to_nothing():
    """Not to denormal numbers, which are slow."""
    bins = np.zeros((4, 4), np.uint16)
    f, b = np.full((2, 32), 1e-3, np.float32)
    for _ in range(1100):
        color.learn_colors(bins, (1, 1, 3, 3), (1, 1, 3, 3), np.float32(0.04), np.zeros((2, 32), np.int32), f, b)
    assert f[0] == pytest.approx(1, abs=1e-5)
    assert not f[1:].any()


@pytest.mark.parametrize("unseen", [0.0, 0.5])
def test_tabulate(unseen):
    f, b = (np.random.default_rng(1).random((2, 1000)) * (np.random.default_rng(2).random((2, 1000)) > 0.6)).astype(
        np.float32
    )
    lookup = np.empty(1000, np.float32)
    color.tabulate(f, b, np.float32(unseen), lookup)
    close(lookup, reference.tabulate(f, b, unseen))


def test_look_up_and_box_means(picture):
    patch = patch_of(picture, 100, 120)
    bins = reference.bin_pixels(patch).astype(np.uint16)
    lookup = np.random.default_rng(2).random(32**3).astype(np.float32)
    integral = np.full((101, 121), np.nan, np.float32)
    color.look_up(bins, lookup, integral)
    close(integral, reference.integral(bins, lookup))
    rows, columns = np.array([0, 1, 40, 69, 69]), np.array([0, 33, 100])
    out = np.empty((5, 3), np.float32)
    color.box_means(integral, rows, columns, 31, 20, out)
    np.testing.assert_allclose(out, reference.box_means(lookup[bins], rows, columns, 31, 20), atol=1e-4)


# --- correlation filters ---

N = 9
BLOCKS = np.array([(0, 1), (1, 4), (4, 7)], np.int64)


@pytest.fixture
def spectra():
    return complex_noise(np.random.default_rng(3), 7, N, N // 2 + 1)


@pytest.fixture
def label_f():
    return complex_noise(np.random.default_rng(4), N, N // 2 + 1)


def energies_of(spectra):
    out = np.empty((len(BLOCKS), *spectra.shape[1:]), np.float32)
    for block, energy in zip(BLOCKS, out, strict=True):
        template.energy(spectra, block, energy)
    return out


def test_energy(spectra):
    close(energies_of(spectra), np.stack([reference.energy(spectra, block) for block in BLOCKS]))


def test_respond_filters(spectra):
    filters = complex_noise(np.random.default_rng(5), *spectra.shape)
    out = np.empty((len(BLOCKS), *spectra.shape[1:]), np.complex64)
    template.respond_filters(filters, spectra, BLOCKS, out)
    close(out, reference.respond_filters(filters, spectra, BLOCKS))


@pytest.mark.parametrize("rate", [0.02, 1.0])
def test_learn_filters(spectra, label_f, rate):
    filters = complex_noise(np.random.default_rng(6), *spectra.shape)
    expected = reference.learn_filters(spectra, label_f, BLOCKS, 0.3, rate, filters)
    template.learn_filters(spectra, label_f, BLOCKS, np.float32(0.3), np.float32(rate), energies_of(spectra), filters)
    close(filters, expected)


@pytest.mark.parametrize("rate", [0.02, 1.0])
def test_learn_spectra(spectra, label_f, rate):
    rng = np.random.default_rng(7)
    mean = complex_noise(rng, *spectra.shape)
    denominator = rng.random((len(BLOCKS), *spectra.shape[1:])).astype(np.float32)
    filters = np.zeros_like(mean)
    expected = reference.learn_spectra(spectra, label_f, BLOCKS, 0.3, rate, mean, denominator)
    template.learn_spectra(
        spectra,
        label_f,
        BLOCKS,
        np.float32(0.3),
        np.float32(rate),
        energies_of(spectra),
        mean,
        denominator,
        filters,
    )
    for actual, wanted in zip((mean, denominator, filters), expected, strict=True):
        close(actual, wanted)


@pytest.mark.parametrize(("before", "penalty"), [(0.0, 1.0), (1.0, 10.0)])
def test_solve_background(spectra, label_f, before, penalty):
    rng = np.random.default_rng(8)
    filters, unmasked = complex_noise(rng, *spectra.shape), complex_noise(rng, *spectra.shape)
    power = reference.energy(spectra, (0, len(spectra))) / spectra.shape[1] ** 2
    arguments = (spectra, label_f, power.astype(np.float32), np.float32(before), np.float32(penalty), filters)
    expected = reference.solve_background(*arguments, unmasked)
    background.solve_background(*arguments, unmasked)
    close(unmasked, expected)


# --- Fourier ---


@pytest.mark.parametrize("n", [3, 7, 8, 25])
def test_fold_rows(n):
    grids = np.random.default_rng(8).standard_normal((n, 30)).astype(np.float32)
    even, odd = np.full((n // 2 + 1, 30), np.nan, np.float32), np.full(((n - 1) // 2, 30), np.nan, np.float32)
    fourier.fold_rows(grids, even, odd)
    for actual, expected in zip((even, odd), reference.fold_rows(grids), strict=True):
        close(actual, expected)


@pytest.mark.parametrize("n", [7, 8])
def test_assemble(n):
    """From the products of cosines and sines to the half spectra."""
    grids = np.random.default_rng(12).standard_normal((3, n, n))
    angles = 2 * np.pi / n * np.outer(np.arange(n), np.arange(n))
    half = n // 2 + 1
    rows = np.concatenate([np.cos(angles)[:half], np.sin(angles)[1 : (n + 1) // 2]])
    columns = np.concatenate([np.cos(angles)[:half], np.sin(angles)[:half], np.ones((1, n))])
    products = np.einsum("ry,cyx,kx->rck", rows, grids, columns).astype(np.float32)
    out = np.empty((3, n, half), np.complex64)
    fourier.assemble(products, out)
    close(out, np.fft.rfft2(grids))


# --- fusion ---


@pytest.mark.parametrize("floor", [0, 1, 2])
@pytest.mark.parametrize("power", [1, 2])
def test_fuse_maps(floor, power):
    rng = np.random.default_rng(9)
    responses = rng.standard_normal((4, 11, 15)).astype(np.float32)
    responses[2] = 0.25  # flat
    weights = np.array([1, 1, 1, 0.3], np.float32)
    expected, expected_fused = reference.fuse_maps(responses, weights, floor, power)
    fused = np.empty((11, 15), np.float32)
    fusion.fuse_maps(responses, weights, floor, power, fused)
    close(responses, expected)
    close(fused, expected_fused)


@pytest.mark.parametrize("seed", range(12))
def test_find_peak(seed):
    rng = np.random.default_rng(seed)
    fused = rng.random(tuple(rng.choice([5, 9, 17, 25], 2))).astype(np.float32)
    if seed % 3 == 0:  # on the border
        fused[rng.integers(2) * -1, rng.integers(fused.shape[1])] = 2
    np.testing.assert_allclose(fusion.find_peak(fused, 5), reference.find_peak(fused, 5), rtol=1e-4, atol=1e-4)


# --- scale ---


LANES = 24
"""Eight smaller scales, eight larger ones, the present one, padding."""


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


@pytest.mark.parametrize("epsilon", [1e-2, 10.0])
def test_scale_features(samples, epsilon):
    histogram = histogram_of(samples, 17)
    window = np.zeros(LANES, np.float32)
    window[:8] = window[8:16] = np.linspace(1, 0.1, 8)
    window[16] = 1
    norms = np.full((7, 5, LANES), np.nan, np.float32)
    even, odd = np.full((6 * 4 * 31, 9), np.nan, np.float32), np.full((6 * 4 * 31, 8), np.nan, np.float32)
    scale.scale_norms(histogram, np.float32(epsilon), norms)
    scale.scale_features(histogram, norms, window, even, odd)
    cells_ = np.moveaxis(histogram[:-1].reshape(6, 4, 18, LANES), 1, 2)
    expected = reference.fold(reference.scale_features(cells_, epsilon, window), 8)
    np.testing.assert_allclose(even, expected[0], atol=1e-3)
    np.testing.assert_allclose(odd, expected[1], atol=1e-3)


def test_scale_hog(gray):
    """The parts in one call."""
    cut = patch_of(gray, 60, 80)
    step = np.linspace(0.8, 3.2, LANES, dtype=np.float32)
    window, epsilon, center = np.ones(LANES, np.float32), np.float32(10), (np.float32(39.3), np.float32(31.7))
    samples, histogram = np.empty((24, 16, LANES), np.float32), np.empty((25, 18, LANES), np.float32)
    quads, norms = np.empty((60, 80), np.uint32), np.empty((7, 5, LANES), np.float32)
    even, odd = np.empty((24 * 31, 9), np.float32), np.empty((24 * 31, 8), np.float32)
    scale.scale_hog(cut, *center, step, step, 17, epsilon, window, quads, samples, histogram, norms, even, odd)
    assert np.array_equal(quads, quads_of(cut))
    np.testing.assert_allclose(samples, reference.sample_scales(cut, 39.3, 31.7, step, step, (24, 16)), atol=0.02)
    assert np.array_equal(histogram, histogram_of(samples, 17))
    expected_even, expected_odd = np.empty_like(even), np.empty_like(odd)
    scale.scale_features(histogram, norms, window, expected_even, expected_odd)
    np.testing.assert_allclose(even, expected_even, atol=1e-5)
    np.testing.assert_allclose(odd, expected_odd, atol=1e-5)


def test_fold():
    values = np.random.default_rng(11).random(LANES).astype(np.float32)
    even, odd = np.empty(9, np.float32), np.empty(8, np.float32)
    scale.fold(values, even, odd)
    for actual, expected in zip((even, odd), reference.fold(values, 8), strict=True):
        close(actual, expected)


def test_scale_filter():
    rng = np.random.default_rng(10)
    waves, mean = rng.standard_normal((2, 50, 16)).astype(np.float32)
    sums, mean_sums = rng.standard_normal((2, 50)).astype(np.float32)
    gain, energy = rng.random((2, 9)).astype(np.float32)
    complex_, complex_mean = reference.complex_scales(waves, sums), reference.complex_scales(mean, mean_sums)
    response_f = np.empty(17, np.float32)
    scale.respond_scales(waves, sums, mean, mean_sums, gain, response_f)
    expected = reference.respond_scales(complex_, complex_mean) * np.roll(gain, 1)
    close(reference.complex_scales(response_f[None, :16], response_f[16:])[0], expected, 1e-4)
    expected_mean, expected_energy = reference.learn_scales(complex_, 0.025, complex_mean, np.roll(energy, 1))
    scale.learn_scales(waves, sums, np.float32(0.025), mean, mean_sums, energy)
    close(reference.complex_scales(mean, mean_sums), expected_mean)
    close(np.roll(energy, 1), expected_energy)


def test_every_kernel_has_a_test():
    """A new kernel needs a twin: its name must appear here."""
    source = Path(__file__).read_text()
    for module in (background, cells, color, fourier, fusion, hog, scale, template):
        for name, value in vars(module).items():
            if hasattr(value, "py_func") and value.py_func.__module__ == module.__name__:
                called = f"{module.__name__.rsplit('.', 1)[1]}.{name}"
                assert f"{called}(" in source or f"alone({called})" in source
