"""Every numba kernel agrees with its numpy twin to float tolerance, on rendered, real, noisy and flat pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core.features import color_names, hann_window
from mfcmt_core.kernels import background, cells, coded, color, fourier, fusion, hog, scale, template

from . import reference
from .twins import close, patch_of

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
    histogram = np.full((cells_y, 18, cells_x + 2), np.nan, np.float32)
    hog.histogram_cells(magnitude, orientation, np.full((4, 18, cells_x + 2), np.nan, np.float32), histogram)
    close(histogram[..., 1:-1], reference.histogram_cells(magnitude, orientation))


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
    bordered = np.pad(histogram, ((0, 0), (0, 0), (1, 1)), constant_values=np.nan)
    hog.normalize_cells(bordered, window, np.float32(epsilon), norms, 1, out)
    close(np.moveaxis(out[:, 1:], 1, 0), reference.normalize_cells(histogram, window, epsilon))
    assert np.isnan(out[:, 0]).all()


@pytest.mark.parametrize("seed", range(4))
def test_direction(seed):
    dx, dy = np.random.default_rng(seed).integers(-255, 256, 2).astype(np.float32)
    along = reference.projections(float(dx), float(dy))
    assert along[hog.direction(dx, dy)] == pytest.approx(along.max())


def test_directions_of_all_quadrants():
    for angle in np.arange(0, 360, 7.3):  # none half-way between two directions
        dx, dy = np.float32(np.cos(np.radians(angle))), np.float32(np.sin(np.radians(angle)))
        assert hog.direction(dx, dy) == round(angle / 20) % 18
    # on the axes and where there is nothing
    turns = [hog.direction(np.float32(x), np.float32(y)) for x, y in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1))]
    assert turns == [0, 0, 4, 9, 13]


def test_hog_cells(gray):
    """One call equals the calls of its parts."""
    patch = patch_of(gray, 32, 60)
    window = np.random.default_rng(0).random((8, 15)).astype(np.float32)
    magnitude, orientation = np.empty((32, 60), np.float32), np.empty((32, 60), np.uint8)
    scratch = (np.empty((4, 18, 17), np.float32), np.empty((8, 18, 17), np.float32), np.empty((9, 16), np.float32))
    out, expected = np.zeros((2, 8, 32, 15), np.float32)
    hog.hog_cells(patch, window, np.float32(1), 1, magnitude, orientation, *scratch, out)
    hog.normalize_cells(scratch[1], window, np.float32(1), scratch[2], 1, expected)
    close(out, expected)
    close(scratch[1][..., 1:-1], reference.histogram_cells(magnitude, orientation))


# --- colour ---


def test_bin_gray(gray):
    bins = np.empty(gray.shape, np.uint16)
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
@pytest.mark.parametrize(("rate", "gain"), [(0.0, 1.0), (0.04, 1.0), (0.04, 25.0), (1.0, 1.0)])
@pytest.mark.parametrize("moved", [(0, 0), (3, -7), (-60, 45)])
def test_learn_colors(picture, inner, outer, moved, rate, gain):
    bins = reference.bin_pixels(patch_of(picture, 100, 100)).astype(np.uint16)
    histograms = (np.random.default_rng(1).random((32**3, 2)) / 1000).astype(np.float32)
    before, lookup = histograms.copy(), np.full(32**3, -1, np.float32)
    added = reference.count_colors(bins, *(reference.shift(r, *moved, 100, 100) for r in (inner, outer)), 32**3)
    ones = [np.float32(rate * gain / max(count.sum(), 1)) for count in added]
    counts, shown = np.zeros(32**3, np.int64), np.empty(100 * 100, np.uint16)
    rate, gain, unseen = np.float32([rate, gain, 0])
    color.learn_colors(bins, inner, outer, *moved, rate, gain, unseen, shown, counts, histograms, lookup)
    assert not counts.any()
    close(histograms, before + np.stack(added, 1) * ones)
    seen = np.flatnonzero(sum(added))
    close(lookup[seen], reference.tabulate(histograms[seen], 0))
    assert (np.delete(lookup, seen) == -1).all()


@pytest.mark.parametrize("moved", [(0, 0), (5, -3), (-40, 2), (70, 80)])
def test_shift(moved):
    """A rectangle outside the patch is empty and has an area of one pixel."""
    rectangle, area = color.shift((20, 30, 50, 70), *moved, 100, 110)
    assert rectangle == reference.shift((20, 30, 50, 70), *moved, 100, 110)
    inside = np.zeros((100, 110), bool)
    inside[slice(rectangle[0], rectangle[2]), slice(rectangle[1], rectangle[3])] = True
    assert area == max(inside.sum(), 1)


def test_count_color():
    """The first pixel of a color appends it to the list."""
    counts, shown = np.zeros(5, np.int64), np.empty(4, np.uint16)
    number = np.uint64(0)
    for bin_ in (3, 1, 3, 3):
        number = color.count_color(bin_, 1, number, counts, shown)
    assert counts.tolist() == [0, 1, 0, 3, 0]
    assert shown[:number].tolist() == [3, 1]


@pytest.mark.parametrize("unseen", [0.0, 0.5])
def test_tabulate(unseen):
    rng = np.random.default_rng(1)
    histograms = (rng.random((1000, 2)) * (rng.random((1000, 2)) > 0.6)).astype(np.float32)
    lookup = np.empty(1000, np.float32)
    color.tabulate(histograms, np.float32(unseen), lookup)
    close(lookup, reference.tabulate(histograms, unseen))
    assert color.likelihood(np.float32(0), np.float32(0), np.float32(unseen)) == np.float32(unseen)


def test_integrate_likelihood_and_box_means(picture):
    patch = patch_of(picture, 100, 120)
    bins = reference.bin_pixels(patch).astype(np.uint16)
    lookup = np.random.default_rng(2).random(32**3).astype(np.float32)
    integral = np.full((101, 121), np.nan, np.float32)
    color.integrate_likelihood(bins, lookup, integral)
    close(integral, reference.integral(bins, lookup))
    rows, columns = np.array([0, 1, 40, 69, 69]), np.array([0, 33, 100])
    out = np.empty((5, 3), np.float32)
    color.box_means(integral, rows, columns, 31, 20, out)
    np.testing.assert_allclose(out, reference.box_means(lookup[bins], rows, columns, 31, 20), atol=1e-4)
    at_once = np.full_like(out, np.nan)
    color.likelihood_map(bins, lookup, np.empty_like(integral), rows, columns, 31, 20, 5, 3, np.float32(0), at_once)
    assert np.array_equal(at_once, out)
    half = np.float32(0.5)
    color.subtract_bands(integral, rows, columns, 31, 20, 5, 3, half, out)
    np.testing.assert_allclose(
        out, reference.box_contrasts(lookup[bins], rows, columns, (31, 20), (5, 3), 0.5), atol=1e-4
    )
    color.likelihood_map(bins, lookup, np.empty_like(integral), rows, columns, 31, 20, 5, 3, half, at_once)
    assert np.array_equal(at_once, out)


def test_a_box_that_fills_the_patch_has_no_band(picture):
    bins = reference.bin_pixels(patch_of(picture, 40, 50)).astype(np.uint16)
    lookup, one = np.random.default_rng(2).random(32**3).astype(np.float32), np.array([0])
    integral, out = np.empty((41, 51), np.float32), np.empty((1, 1), np.float32)
    color.likelihood_map(bins, lookup, integral, one, one, 40, 50, 4, 5, np.float32(1), out)
    np.testing.assert_allclose(out, lookup[bins].mean(), rtol=1e-4)


# --- fusion ---


@pytest.mark.parametrize("floor", [0, 1, 2])
@pytest.mark.parametrize("power", [1, 2])
def test_fuse_maps(floor, power):
    rng = np.random.default_rng(9)
    responses = rng.standard_normal((4, 11, 15)).astype(np.float32)
    responses[2] = 0.25  # flat
    weights = np.array([1, 1, 1, 0.3], np.float32)
    expected, expected_fused = reference.fuse_maps(responses, weights, floor, power)
    fused, tops, again = np.empty((11, 15), np.float32), np.empty(4, np.float32), responses.copy()
    highest = responses.max((1, 2))
    fusion.fuse_maps(responses, weights, floor, power, tops, fused)
    close(responses, expected)
    close(fused, expected_fused)
    assert np.array_equal(tops, highest)
    found = fusion.fuse_and_find(again, weights, floor, power, 5, tops, np.empty_like(fused))
    np.testing.assert_allclose(found, fusion.find_peak(fused, 5), rtol=1e-4)


@pytest.mark.parametrize("seed", range(12))
def test_find_peak(seed):
    rng = np.random.default_rng(seed)
    fused = rng.random(tuple(rng.choice([5, 9, 17, 25], 2))).astype(np.float32)
    if seed % 3 == 0:  # on the border
        fused[rng.integers(2) * -1, rng.integers(fused.shape[1])] = 2
    np.testing.assert_allclose(fusion.find_peak(fused, 5), reference.find_peak(fused, 5), rtol=1e-4, atol=1e-4)


def test_second_peak_ratio():
    fused = np.random.default_rng(3).random((25, 31), np.float32)
    far = fused.copy()
    i, j = np.unravel_index(fused.argmax(), fused.shape)
    far[max(0, i - 4) : i + 5, max(0, j - 4) : j + 5] = 0
    assert fusion.second_peak_ratio(fused, 4) == pytest.approx(far.max() / fused.max())


def test_every_kernel_has_a_test():
    """Its name must appear in a test file of kernels."""
    source = "".join(file.read_text() for file in Path(__file__).parent.glob("test_kernels*.py"))
    for module in (background, cells, coded, color, fourier, fusion, hog, scale, template):
        for name, value in vars(module).items():
            if hasattr(value, "py_func") and value.py_func.__module__ == module.__name__:
                assert f"{module.__name__.rsplit('.', 1)[1]}.{name}(" in source
