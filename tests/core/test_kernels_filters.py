"""The kernels of the template filters and their transforms, each with its numpy twin."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core.kernels import background, fourier, template

from . import reference
from .twins import close, complex_noise

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


def test_correlate(spectra):
    filters, out = complex_noise(np.random.default_rng(5), *spectra.shape), np.empty(spectra.shape[1:], np.complex64)
    template.correlate(filters, spectra, 1, 4, out)
    close(out, reference.respond_filters(filters, spectra, [(1, 4)])[0])


@pytest.mark.parametrize("background", [False, True])
def test_respond_filters(spectra, background):
    rng = np.random.default_rng(5)
    numerator, filters = complex_noise(rng, *spectra.shape), complex_noise(rng, *spectra.shape)
    quotient = complex_noise(rng, len(BLOCKS), *spectra.shape[1:])
    out = np.empty((len(BLOCKS) + background, *spectra.shape[1:]), np.complex64)
    template.respond_filters(numerator, quotient, BLOCKS, filters if background else filters[:0], spectra, out)
    close(out[: len(BLOCKS)], quotient * reference.respond_filters(numerator, spectra, BLOCKS))
    if background:
        close(out[-1:], reference.respond_filters(filters, spectra, [(0, len(spectra))]))


@pytest.mark.parametrize("offset", [(0.0, 0.0), (1.0, -2.0), (0.3, 0.71), (-9.4, 4.5)])
@pytest.mark.parametrize("n", [8, N])
def test_phase_shift(n, offset):
    spectra = complex_noise(np.random.default_rng(9), 5, n, n // 2 + 1)
    expected = reference.phase_shift(spectra, *offset)
    template.phase_shift(spectra, *offset)
    close(spectra, expected)


@pytest.mark.parametrize("n", [8, N])
@pytest.mark.parametrize("offset", [(1, 0), (0, 1), (-3, 2), (4, 4)])
def test_phase_shift_undoes_a_roll(n, offset):
    """``offset`` (x, y) is where the middle has moved to, in cells."""
    grids = np.random.default_rng(10).standard_normal((3, n, n))
    dx, dy = offset
    spectra = np.fft.rfft2(np.roll(grids, (dy, dx), (1, 2))).astype(np.complex64)
    template.phase_shift(spectra, dx, dy)
    close(spectra, np.fft.rfft2(grids))


@pytest.mark.parametrize("offset", [(0.5, 0.25), (-1.3, 0.8)])
def test_phase_shift_by_a_fraction_of_a_cell(offset):
    """Between the cells, the picture is the sum of the waves through them."""
    grid = np.random.default_rng(11).standard_normal((N, N))
    spectra = np.fft.rfft2(grid[None]).astype(np.complex64)
    template.phase_shift(spectra, *offset)
    (dx, dy), frequencies, cells_ = offset, np.fft.fftfreq(N) * N, np.arange(N)
    across = np.exp(2j * np.pi / N * np.outer(cells_ + dx, frequencies))
    down = np.exp(2j * np.pi / N * np.outer(cells_ + dy, frequencies))
    between = down @ np.fft.fft2(grid) @ across.T / N**2
    close(np.fft.irfft2(spectra[0], s=(N, N)), between.real)


def test_divide_label(spectra, label_f):
    energies, quotient = energies_of(spectra), np.empty((len(BLOCKS), *label_f.shape), np.complex64)
    template.divide_label(label_f, energies, np.float32(0.3), quotient)
    close(quotient, reference.divide_label(label_f, energies, 0.3))


@pytest.mark.parametrize("rate", [0.02, 1.0])
def test_learn_filters(spectra, label_f, rate):
    filters = complex_noise(np.random.default_rng(6), *spectra.shape)
    expected = reference.learn_filters(spectra, label_f, BLOCKS, 0.3, rate, filters)
    template.learn_filters(spectra, label_f, BLOCKS, np.float32(0.3), np.float32(rate), energies_of(spectra), filters)
    close(filters, expected)


@pytest.mark.parametrize("rate", [0.02, 1.0])
def test_learn_spectra(spectra, rate):
    rng = np.random.default_rng(7)
    numerator = complex_noise(rng, *spectra.shape)
    denominator = rng.random((len(BLOCKS), *spectra.shape[1:])).astype(np.float32)
    expected = reference.learn_spectra(spectra, BLOCKS, rate, numerator, denominator)
    template.learn_spectra(spectra, BLOCKS, np.float32(rate), numerator, denominator)
    for actual, wanted in zip((numerator, denominator), expected, strict=True):
        close(actual, wanted)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.4, -0.7)])
def test_learn_shifted_spectra(spectra, label_f, offset):
    """One call equals the calls of its parts."""
    rng = np.random.default_rng(12)
    numerator = complex_noise(rng, *spectra.shape)
    denominator = rng.random((len(BLOCKS), *spectra.shape[1:])).astype(np.float32)
    quotient = np.empty(denominator.shape, np.complex64)
    turned = reference.phase_shift(spectra, *offset).astype(np.complex64)
    expected = reference.learn_spectra(turned, BLOCKS, 0.02, numerator, denominator)
    rate, regularization = np.float32(0.02), np.float32(0.3)
    template.learn_shifted_spectra(
        spectra, *offset, BLOCKS, rate, label_f, regularization, numerator, denominator, quotient
    )
    for actual, wanted in zip((spectra, numerator, denominator), (turned, *expected), strict=True):
        close(actual, wanted)
    close(quotient, reference.divide_label(label_f, denominator, 0.3))


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
    """Assemble the half spectra from the products with cosines and sines."""
    grids = np.random.default_rng(12).standard_normal((3, n, n))
    angles = 2 * np.pi / n * np.outer(np.arange(n), np.arange(n))
    half = n // 2 + 1
    rows = np.concatenate([np.cos(angles)[:half], np.sin(angles)[1 : (n + 1) // 2]])
    columns = np.concatenate([np.cos(angles)[:half], np.sin(angles)[:half], np.ones((1, n))])
    products = np.einsum("ry,cyx,kx->rck", rows, grids, columns).astype(np.float32)
    out = np.empty((3, n, half), np.complex64)
    fourier.assemble(products, out)
    close(out, np.fft.rfft2(grids))
