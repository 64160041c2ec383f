"""Equations 4–7 and 11 of the statistical model against direct evaluations."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core import MFCMTConfig
from mfcmt_core.color import ColorModel
from mfcmt_core.geometry import SearchWindow

from . import reference

CONFIG = MFCMTConfig.default()


def model(target=(56.0, 44.0), is_gray=False, **changes) -> ColorModel:
    config = CONFIG.replace(**changes)
    return ColorModel(config, SearchWindow(config, target), is_gray)


def few_colors(seed=0, side=CONFIG.patch_size):
    """Return a patch of few colors, most of which occur in both regions."""
    rng = np.random.default_rng(seed)
    palette = rng.integers(0, 256, (12, 3), np.uint8)
    return palette[rng.integers(0, 12, (side, side))]


def regions(m: ColorModel, side):
    """Return masks of foreground and background from the model's rectangles."""
    inner, outer = np.zeros((side, side), bool), np.ones((side, side), bool)
    inner[m.inner[0] : m.inner[2], m.inner[1] : m.inner[3]] = True
    outer[m.outer[0] : m.outer[2], m.outer[1] : m.outer[3]] = False
    return inner, outer


def histograms(m: ColorModel):
    """Return foreground and background histograms, (bins, 2), each with sum 1."""
    return m.histograms / m.decay_scale


def test_equation_6_is_the_regression_of_equation_5():
    """v minimizes the mean of (v·x - 1)² over F plus the mean of (v·x)² over B, with x one-hot; unseen bins stay 0."""
    m = model()
    bins = m.bins(few_colors()).copy()
    m.learn(bins, first=True)
    inner, outer = regions(m, len(bins))
    seen, index = np.unique(bins, return_inverse=True)
    index = index.reshape(bins.shape)
    weight = np.where(inner, 1 / inner.sum(), 0) + np.where(outer, 1 / outer.sum(), 0)
    used = weight > 0
    design = np.eye(len(seen))[index[used]] * np.sqrt(weight[used])[:, None]
    solution, *_ = np.linalg.lstsq(design, inner[used] * np.sqrt(weight[used]), rcond=None)
    np.testing.assert_allclose(m.lookup[seen], solution, atol=1e-4)
    assert np.count_nonzero(m.lookup) <= len(seen)


def test_equation_4_gives_the_histograms_per_bin():
    """For each bin, no other value is better than that of equation 6."""
    m = model()
    bins = m.bins(few_colors(3)).copy()
    m.learn(bins, first=True)
    inner, outer = regions(m, len(bins))
    for b in np.unique(bins):
        f, g = (bins[inner] == b).mean(), (bins[outer] == b).mean()
        candidates = np.linspace(0, 1, 101)
        losses = f * (candidates - 1) ** 2 + g * candidates**2
        assert f * (m.lookup[b] - 1) ** 2 + g * m.lookup[b] ** 2 <= losses.min() + 1e-6


def test_regions_are_the_inner_85_percent_and_all_outside_the_target():
    m = model((50.0, 30.0))
    patch = few_colors()
    side = len(patch)
    search = SearchWindow(CONFIG, (50.0, 30.0))
    target = [side * t / e for t, e in zip((50.0, 30.0), search.extent, strict=True)]
    for rectangle, part in ((m.outer, 1.0), (m.inner, CONFIG.foreground_fraction)):
        top, left, bottom, right = rectangle
        assert abs(right - left - part * target[0]) <= 0.5
        assert abs(bottom - top - part * target[1]) <= 0.5
        assert abs((left + right) - side) <= 1
        assert abs((top + bottom) - side) <= 1
    # a colour that occurs in the ring between them only has no say
    patch[m.outer[0] : m.outer[2], m.outer[1] : m.outer[3]] = (1, 2, 3)
    patch[m.inner[0] : m.inner[2], m.inner[1] : m.inner[3]] = (200, 100, 0)
    m.learn(m.bins(patch), first=True)
    ring = m.bins(np.full((1, 1, 3), (1, 2, 3), np.uint8))[0, 0]
    assert m.histograms[ring].tolist() == [0, 0]
    assert m.lookup[ring] == 0
    np.testing.assert_allclose(histograms(m).sum(0), 1, atol=1e-3)


@pytest.mark.parametrize("unseen", [0.0, 0.5])
def test_unseen_colors_have_the_configured_likelihood(unseen):
    m = model(unseen_likelihood=unseen)
    bins = m.bins(few_colors())
    m.learn(bins, first=True)
    never = np.setdiff1d(np.arange(32**3), np.unique(bins))
    assert (m.lookup[never] == np.float32(unseen)).all()


@pytest.mark.parametrize("is_gray", [False, True])
def test_equation_7_is_the_box_mean(is_gray):
    m = model(is_gray=is_gray, surroundings_weight=0)
    patch = few_colors(1)[..., 0].copy() if is_gray else few_colors(1)
    bins = m.bins(patch).copy()
    m.learn(bins, first=True)
    out = np.empty((len(m.rows), len(m.columns)), np.float32)
    m.respond(bins, out)
    width, height = m.box
    np.testing.assert_allclose(out, reference.box_means(m.lookup[bins], m.rows, m.columns, height, width), atol=1e-4)
    assert 0 <= out.min() <= out.max() <= 1 + 1e-4


def test_a_band_of_the_same_colors_counts_against_a_box():
    """Likely colors everywhere keep half of their likelihood; inside the box only, all of it."""
    m = model()
    out = np.empty((len(m.rows), len(m.columns)), np.float32)
    inside = np.zeros((100, 100), np.uint16)
    m.lookup[:] = 1
    m.respond(inside, out)
    np.testing.assert_allclose(out, 0.5, atol=1e-4)
    m.lookup[1] = 0
    inside[:] = 1
    inside[m.outer[0] : m.outer[2], m.outer[1] : m.outer[3]] = 0
    m.respond(inside, out)
    middle = len(m.rows) // 2, len(m.columns) // 2
    assert np.unravel_index(out.argmax(), out.shape) == middle
    assert out[middle] == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("shift", [(0, 0), (8, -4), (-12, 16)])
def test_the_target_s_colors_are_found_at_their_new_place(shift):
    m = model()
    search = SearchWindow(CONFIG, (56.0, 44.0))

    def patch(dx, dy):
        image = np.full((100, 100, 3), (40, 90, 40), np.uint8)
        image[m.outer[0] + dy : m.outer[2] + dy, m.outer[1] + dx : m.outer[3] + dx] = (30, 30, 200)
        return image

    m.learn(m.bins(patch(0, 0)), first=True)
    out = np.empty((2 * search.reach[1] + 1, 2 * search.reach[0] + 1), np.float32)
    m.respond(m.bins(patch(*shift)), out)
    assert out.max() == pytest.approx(1, abs=1e-3)
    row, column = np.unravel_index(out.argmax(), out.shape)
    assert (4 * (column - search.reach[0]), 4 * (row - search.reach[1])) == shift


def test_equation_11_averages_histograms():
    m, other = model(histogram_learning_rate=0.25), model()
    m.learn(m.bins(few_colors(0)), first=True)
    before = histograms(m)
    other.learn(other.bins(few_colors(9)), first=True)
    m.learn(m.bins(few_colors(9)))
    np.testing.assert_allclose(histograms(m), 0.75 * before + 0.25 * histograms(other), atol=1e-6)
    f, b = histograms(m).T
    expected = np.divide(f, f + b, out=np.zeros_like(f), where=f + b > 0)
    np.testing.assert_allclose(m.lookup, expected, atol=1e-6)


@pytest.mark.parametrize("offset", [(1.0, -1.0), (0.4, 0.1), (-6.0, 8.0), (9.0, 0.0)])
def test_the_regions_move_with_the_target(offset):
    """They move by whole pixels. The part beyond the patch is cut off, and the rest counts as the whole region."""
    m = model()
    patch = few_colors(4)
    bins = m.bins(patch)
    m.learn(bins, offset, first=True)
    dx, dy = (round(4 * v) for v in offset)
    y, x = np.indices(bins.shape) - np.array([dy, dx])[:, None, None]

    def inside(rectangle):
        top, left, bottom, right = rectangle
        return (y >= top) & (y < bottom) & (x >= left) & (x < right)

    counts = [np.bincount(bins[where], minlength=32**3) for where in (inside(m.inner), ~inside(m.outer))]
    expected = np.stack([count / count.sum() for count in counts], 1)
    np.testing.assert_allclose(histograms(m), expected, atol=1e-6)
    assert histograms(m).sum(0) == pytest.approx([1, 1], abs=1e-3)


@pytest.mark.parametrize("offset", [(2.0, -1.0), (-1.0, 3.0)])
def test_colors_learned_off_the_middle_are_those_of_a_target_there(offset):
    """A patch rolled back to the middle has the same target, because the ground has one color."""
    m, other = model(), model()
    patch = np.full((100, 100, 3), (40, 90, 40), np.uint8)
    patch[m.outer[0] : m.outer[2], m.outer[1] : m.outer[3]] = few_colors(2)[: m.box[1], : m.box[0]]
    other.learn(other.bins(patch), first=True)
    moved = np.roll(patch, [round(4 * v) for v in offset[::-1]], (0, 1))
    m.learn(m.bins(moved), offset, first=True)
    np.testing.assert_allclose(m.histograms, other.histograms, atol=1e-6)
    np.testing.assert_allclose(m.lookup, other.lookup, atol=1e-6)


def test_histograms_are_rescaled_before_they_overflow():
    """The look-up of visible colors does not change, and colors that were seen long ago are forgotten."""
    m = model()
    m.learn(m.bins(few_colors(0)), first=True)
    old, new = m.bins(few_colors(0)), m.bins(few_colors(1))
    gains = [float(m.decay_scale[0])]
    while gains[-1] >= gains[-2:][0]:
        before = m.lookup.copy()
        m.learn(new)
        gains.append(float(m.decay_scale[0]))
        assert gains[-1] <= 1e9
    assert gains[-1] == 1
    assert len(gains) > 400
    np.testing.assert_allclose(m.lookup[np.unique(new)], before[np.unique(new)], rtol=1e-5)
    for _ in range(250):
        m.learn(new)
    while m.decay_scale[0] != 1:
        m.learn(new)
    gone = np.setdiff1d(old, new)
    assert not m.histograms[gone].any()
    assert not m.lookup[gone].any()


def test_refresh_gives_the_same_table_bit_for_bit():
    """A restored tracker computes its table from the histograms."""
    m = model()
    for seed in range(5):
        m.learn(m.bins(few_colors(seed)), first=seed == 0)
    kept, lookup = m.histograms.copy(), m.lookup.copy()
    m.lookup[:] = -1
    m.refresh()
    assert np.array_equal(m.lookup, lookup)
    assert np.array_equal(m.histograms, kept)


def test_a_bin_is_five_bits_per_channel():
    picture = np.random.default_rng(5).integers(0, 256, (37, 41, 3)).astype(np.uint8)
    assert np.array_equal(model().bins(picture), reference.bin_pixels(picture))


def test_a_gray_target_has_one_axis_of_bins():
    assert model(is_gray=True).lookup.shape == (32,)
    assert model(is_gray=False).lookup.shape == (32768,)


@pytest.mark.parametrize("target", [(4.0, 400.0), (400.0, 4.0), (1.0, 1.0), (1000.0, 640.0)])
@pytest.mark.parametrize("window", ["target", "context", "square"])
@pytest.mark.parametrize("factor", [1.2, 2.5, 10.0])
def test_every_shape_of_target_fits_its_patch(target, window, factor):
    m = model(target, window=window, search_area_scale=factor)
    bins = m.bins(few_colors()).copy()
    m.learn(bins, first=True)
    out = np.full((len(m.rows), len(m.columns)), np.nan, np.float32)
    m.respond(bins, out)
    assert ((out >= -CONFIG.surroundings_weight - 1e-4) & (out <= 1 + 1e-4)).all()
    width, height = m.box
    assert 0 <= m.rows.min() <= m.rows.max() <= 100 - height
    assert 0 <= m.columns.min() <= m.columns.max() <= 100 - width
