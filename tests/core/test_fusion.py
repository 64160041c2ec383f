"""Equations 8–10: the fused map is the relative-entropy optimum, and its peak is where it should be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mfcmt_core import MFCMTConfig
from mfcmt_core.fusion import fuse

CONFIG = MFCMTConfig.default().replace(probability="clip", sharpness=1)
MAPS = hnp.arrays(np.float32, (4, 7, 9), elements=st.floats(0, 100, width=32))
WEIGHTS = hnp.arrays(np.float32, 4, elements=st.floats(0.125, 8, width=32))


def run(maps, weights=None, config=CONFIG):
    """Return the probability maps, the fused map and the peak, without changing the arguments."""
    maps, fused = maps.astype(np.float32), np.full(maps.shape[1:], np.nan, np.float32)
    peak = fuse(maps, np.ones(len(maps), np.float32) if weights is None else weights, config, fused)
    return maps.astype(float), fused.astype(float), peak


def test_tops_are_the_highest_responses():
    """They are the peaks that the reliability tests use, from before a response becomes a probability map."""
    maps = np.random.default_rng(3).normal(size=(4, 7, 9)).astype(np.float32)
    assert run(maps)[2].tops == maps.max((1, 2)).tolist()


def objective(maps, weights, q):
    """Return the weighted equation 9: Σ w_l KL(P_l ‖ Q), with 0 · log 0 = 0."""
    total = 0.0
    for p, w in zip(maps, weights, strict=True):
        there = p > 0
        total += w * (p[there] * np.log(p[there] / np.maximum(q[there], 1e-300))).sum()
    return total


@settings(max_examples=60)
@given(MAPS, WEIGHTS, st.integers(0, 2**32 - 1))
def test_no_other_map_of_the_same_sum_has_less_relative_entropy(maps, weights, seed):
    p, q, _ = run(maps, weights)
    np.testing.assert_allclose(p.sum((1, 2)), 1, atol=1e-4)
    assert q.sum() == pytest.approx(1, abs=1e-4)
    assert (q >= 0).all()
    best = objective(p, weights, q)
    rng = np.random.default_rng(seed)
    others = [rng.random(q.shape), q * rng.lognormal(0, 0.3, q.shape), 0.9 * q + 0.1 * rng.random(q.shape), *p]
    for other in others:
        other = other / other.sum() * q.sum()
        assert objective(p, weights, other) >= best - 1e-4 * weights.sum()


@settings(max_examples=40)
@given(MAPS, st.permutations(range(4)))
def test_the_order_of_maps_does_not_matter(maps, order):
    _, q, _ = run(maps)
    _, permuted, _ = run(maps[list(order)])
    np.testing.assert_allclose(permuted, q, atol=1e-6)


@settings(max_examples=40)
@given(MAPS, WEIGHTS)
def test_identical_maps_stay_unchanged(maps, weights):
    p, q, _ = run(np.repeat(maps[:1], 4, axis=0), weights)
    np.testing.assert_allclose(q, p[0], atol=1e-6)


@settings(max_examples=40)
@given(MAPS, WEIGHTS, st.sampled_from([0.25, 3.0, 1000.0]))
def test_scaling_a_response_does_not_change_the_fused_map(maps, weights, factor):
    """A probability map does not depend on the height of its response."""
    _, q, _ = run(maps, weights)
    _, scaled, _ = run(maps * np.float32(factor), weights)
    np.testing.assert_allclose(scaled, q, atol=1e-5)


def test_weights_are_those_of_the_weighted_mean():
    maps = np.random.default_rng(0).random((3, 5, 5))
    weights = np.array([1, 1, 4], np.float32)
    p, q, _ = run(maps, weights)
    np.testing.assert_allclose(q, (p[0] + p[1] + 4 * p[2]) / 6, atol=1e-6)
    _, alone, _ = run(maps, np.array([0, 1, 0], np.float32))
    np.testing.assert_allclose(alone, p[1], atol=1e-6)


@pytest.mark.parametrize(
    ("probability", "sharpness", "expected"),
    [
        ("clip", 1, lambda r: np.maximum(r, 0)),
        ("clip", 2, lambda r: np.maximum(r, 0) ** 2),
        ("minimum", 1, lambda r: r - r.min()),
        ("minimum", 2, lambda r: (r - r.min()) ** 2),
    ],
)
def test_each_choice_of_probability_makes_its_map(probability, sharpness, expected):
    maps = np.random.default_rng(1).standard_normal((2, 7, 7)).astype(np.float32)
    p, _, _ = run(maps, config=CONFIG.replace(probability=probability, sharpness=sharpness))
    for actual, response in zip(p, maps.astype(float), strict=True):
        wanted = expected(response)
        np.testing.assert_allclose(actual, wanted / wanted.sum(), atol=1e-6)


def test_raw_responses_are_not_changed():
    maps = np.random.default_rng(1).standard_normal((2, 7, 7)).astype(np.float32)
    p, q, _ = run(maps, config=CONFIG.replace(probability="raw"))
    np.testing.assert_array_equal(p, maps)
    np.testing.assert_allclose(q, maps.mean(0), atol=1e-6)


@pytest.mark.parametrize("probability", ["clip", "minimum", "raw"])
@pytest.mark.parametrize("value", [0.0, -1.0, 0.3])
def test_flat_maps_do_not_move_the_target(probability, value):
    _, q, peak = run(np.full((3, 9, 11), value), config=CONFIG.replace(probability=probability))
    assert peak.displacement == (0, 0)
    assert peak.psr == 0
    assert np.isfinite(q).all()
    if probability != "raw":
        np.testing.assert_allclose(q, 1 / 99, atol=1e-6)


@settings(max_examples=80)
@given(st.floats(-5, 5), st.floats(-6, 6), st.floats(1, 2.5))
def test_equation_10_with_sub_cell_refinement(dy, dx, sigma):
    """A Gaussian peak is found to a tenth of a cell."""
    y, x = np.mgrid[-8:9, -10:11]
    bump = np.exp(-((y - dy) ** 2 + (x - dx) ** 2) / (2 * sigma**2))
    _, q, peak = run(np.repeat(bump[None], 2, axis=0))
    assert peak.displacement == pytest.approx((dx, dy), abs=0.1)
    assert peak.height == pytest.approx(q.max())


def test_a_sharper_peak_has_a_higher_ratio_to_its_sidelobe():
    y, x = np.mgrid[-12:13, -12:13]
    noise = 0.05 * np.random.default_rng(2).random((1, 25, 25))
    sharp, blunt = (np.exp(-(y**2 + x**2) / (2 * s**2)) for s in (1, 8))
    assert run(sharp + noise)[2].psr > 5 * run(blunt + noise)[2].psr > 0


def test_peak_on_the_border_stays_there():
    maps = np.full((2, 7, 7), 0.1)
    maps[:, 0, 6] = 1
    assert run(maps)[2].displacement == (3, -3)
