"""The step of ADMM that is element-wise in the frequencies."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def solve_background(mean_spectra, label, power, last_penalty, penalty, filters, unmasked):  # type: ignore[no-untyped-def]
    """The unconstrained filter for this ``penalty``, plus the multiplier: what is to be masked next.

    ``mean_spectra`` (channels, n, half) complex64 are the target's spectra x, ``label`` the conjugate of the label over
    n², ``power`` Σ|x|²/n², ``filters`` the masked filter g of the last iteration and ``unmasked`` what it was
    masked from at the penalty ``last_penalty``; ``unmasked`` becomes x·label + γg − x·t / (γ + power), where
    t = Σ conj(x)·(x·label + γg − h) / n² by Sherman–Morrison and h is the multiplier, ``unmasked`` − before·g.
    """
    channels, n, _ = mean_spectra.shape
    size = power.size
    target, inverse = label.ravel(), np.empty(size, np.float32)
    projection = np.zeros(size, np.complex64)
    for channel in range(channels):
        x, g, u = mean_spectra[channel].ravel(), filters[channel].ravel(), unmasked[channel].ravel()
        for k in range(size):
            rest = x[k] * target[k] + (penalty + last_penalty) * g[k] - u[k]
            projection[k] += np.conj(x[k]) * rest
    shared = power.ravel()
    for k in range(size):
        inverse[k] = np.float32(1) / ((penalty + shared[k]) * np.float32(n * n))
        projection[k] = target[k] - projection[k] * inverse[k]
    for channel in range(channels):
        x, g, u = mean_spectra[channel].ravel(), filters[channel].ravel(), unmasked[channel].ravel()
        for k in range(size):
            u[k] = x[k] * projection[k] + penalty * g[k]
