"""What compares a numba kernel with its numpy twin."""

from __future__ import annotations

import numpy as np


def close(actual, expected, tolerance=2e-5):
    """Assert that arrays are equal up to float32, relative to the largest value."""
    assert actual.shape == expected.shape
    np.testing.assert_allclose(actual, expected, rtol=1e-4, atol=tolerance * max(1e-6, np.abs(expected).max()))


def complex_noise(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def patch_of(image, height, width):
    return np.ascontiguousarray(image[20 : 20 + height, 30 : 30 + width])
