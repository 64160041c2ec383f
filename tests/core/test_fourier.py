"""The transforms against numpy's."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core.fourier import Transform


def grids_of(n, channels):
    return np.random.default_rng(n).standard_normal((n, channels, n)).astype(np.float32)


@pytest.mark.parametrize("n", [8, 9, 25, 30, 37, 64, 128])
@pytest.mark.parametrize("channels", [1, 5])
def test_forward_equals_numpy_s_transform(n, channels):
    grids = grids_of(n, channels)
    spectra = Transform(n, (2, 2)).forward(grids)
    assert spectra.dtype == np.complex64
    expected = np.fft.rfft2(np.moveaxis(grids, 1, 0))
    np.testing.assert_allclose(spectra, expected, atol=1e-6 * np.abs(expected).max())


def test_spectra_are_not_scratch():
    transform = Transform(8, (2, 2))
    first = transform.forward(grids_of(8, 2))
    kept = first.copy()
    transform.forward(-grids_of(8, 2))
    assert np.array_equal(first, kept)


@pytest.mark.parametrize(("n", "reach"), [(8, (3, 2)), (25, (12, 12)), (25, (8, 4)), (37, (18, 2))])
def test_backward_equals_numpy_s_inverse(n, reach):
    """The result has the displacements within reach, with zero in the middle."""
    grids = np.moveaxis(grids_of(n, 2), 1, 0)
    rx, ry = reach
    near = np.full((2, 2 * ry + 1, 2 * rx + 1), np.nan, np.float32)
    Transform(n, reach).backward(np.fft.rfft2(grids).astype(np.complex64), near)
    expected = np.roll(grids, (ry, rx), (1, 2))[:, : 2 * ry + 1, : 2 * rx + 1]
    np.testing.assert_allclose(near, expected, atol=1e-5)
