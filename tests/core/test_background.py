"""The background-aware filter against the constrained regression solved densely."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core import background
from mfcmt_core.background import BackgroundAwareFilter
from mfcmt_core.geometry import SearchWindow

from .helpers import filters_of
from .test_template import CONFIG, N, correlation_matrix, label_of, model, noise, spectra_of

PENALTY = CONFIG.regularization * N * N


def learned(x):
    """Return a model that has learned ``x``, and its background-aware filter in space."""
    m = model(background_interval=4)
    m.learn(spectra_of(x))
    assert m.background is not None
    return m, np.fft.irfft2(m.background.filters, s=(N, N))


def box_of(m):
    """Return the cells of the target's box: 60×40 of 135×115 pixels are 4×3 of 8×8 cells."""
    inside = np.zeros((N, N), bool)
    inside[2:5, 2:6] = True
    return np.broadcast_to(inside, (m.features.channels, N, N))


@pytest.fixture
def smooth():
    """Return samples with similar neighbors, as in features."""
    x = noise(0, 42)
    return sum(np.roll(x, shift, (1, 2)) for shift in ((0, 0), (0, 1), (1, 0), (1, 1)))


def test_nothing_is_learned_outside_the_box(smooth):
    m, w = learned(smooth)
    inside = box_of(m)
    assert np.abs(w[~inside]).max() < 1e-6 * np.abs(w).max()
    assert np.abs(w[inside]).min() > 0


def dense(m, x):
    """Solve min ‖A w - y‖² + λ ‖w‖² over filters that are zero outside the box."""
    inside = box_of(m).ravel()
    a, y = correlation_matrix(x), label_of(m).ravel()
    inner = a[:, inside]
    w = np.zeros(a.shape[1])
    w[inside] = np.linalg.solve(inner.T @ inner + PENALTY * np.eye(inner.shape[1]), inner.T @ y)
    return w, lambda v: ((a @ v - y) ** 2).sum() + PENALTY * (v**2).sum()


def test_iterations_converge_to_the_constrained_optimum(smooth, monkeypatch):
    m, _ = learned(smooth)
    best, loss = dense(m, smooth)
    losses = []
    for count in (2, 20, 200):
        monkeypatch.setattr(background, "PENALTIES", (10.0,) * count)
        m.background.train(m.numerator, first=True)
        losses.append(loss(np.fft.irfft2(m.background.filters, s=(N, N)).ravel()))
    assert losses[0] > losses[1] > losses[2] > loss(best) * (1 - 1e-4)
    assert losses[2] == pytest.approx(loss(best), rel=0.02)


def test_a_later_training_continues_from_the_last_one(smooth, monkeypatch):
    """n later trainings of one iteration equal one training with n more iterations."""
    m, w = learned(smooth)
    best, loss = dense(m, smooth)
    losses = [loss(w.ravel())]
    for count in (1, 20, 180):
        for _ in range(count):
            m.background.train(m.numerator)
        losses.append(loss(np.fft.irfft2(m.background.filters, s=(N, N)).ravel()))
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] == pytest.approx(loss(best), rel=0.02)
    again, _ = learned(smooth)
    monkeypatch.setattr(background, "PENALTIES", background.PENALTIES + (background.PENALTIES[-1],) * 201)
    again.background.train(m.numerator, first=True)
    np.testing.assert_allclose(again.background.filters, m.background.filters, atol=1e-4)


def test_a_first_training_forgets_earlier_ones(smooth):
    m, _ = learned(smooth)
    expected = m.background.filters.copy(), m.background.unmasked.copy()
    m.background.train(spectra_of(noise(1, 42)))
    m.background.train(m.numerator, first=True)
    assert np.array_equal(m.background.filters, expected[0])
    assert np.array_equal(m.background.unmasked, expected[1])


def test_two_iterations_are_better_than_a_ridge_filter_masked_to_the_box(smooth):
    m, w = learned(smooth)
    _, loss = dense(m, smooth)
    cut = np.fft.irfft2(filters_of(m), s=(N, N)) * box_of(m)
    assert loss(w.ravel()) < loss(cut.ravel())


def test_its_response_peaks_where_the_target_is(smooth):
    m, _ = learned(smooth)
    out = np.empty((2, N - 1, N - 1), np.float32)
    m.respond(spectra_of(np.roll(smooth, (2, -1), (1, 2))), out)
    assert np.unravel_index(out[1].argmax(), out[1].shape) == (3 + 2, 3 - 1)


def test_it_trains_on_every_fourth_learned_frame(smooth):
    m, _ = learned(smooth)
    trained = []
    for count in range(8):
        before = m.background.filters.copy()
        m.learn(spectra_of(noise(count, 42)), learned=count)
        trained.append(bool((m.background.filters != before).any()))
    assert trained == [False, False, False, True] * 2


@pytest.mark.parametrize("target", [(0.4, 7.9), (3.0, 4.0), (8.0, 8.0)])
def test_boxes_of_any_size_have_a_filter(target, smooth):
    window = SearchWindow(CONFIG, (60.0, 40.0))
    window.target = target
    label = spectra_of(np.eye(1, N * N).reshape(1, N, N))[0]
    trained = BackgroundAwareFilter(window, 42, label, CONFIG.regularization)
    trained.train(spectra_of(smooth), first=True)
    assert np.isfinite(trained.filters).all()
    assert np.abs(trained.filters).max() > 0
