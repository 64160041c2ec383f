"""The step of ADMM that is element-wise over the frequencies."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def solve_background(mean_spectra, label, power, last_penalty, penalty, filters, unmasked):  # type: ignore[no-untyped-def]
    """Solve for the filter without the mask at this ``penalty`` γ, and add the multiplier: one step of ADMM.

    ``mean_spectra`` (channels, n, half) complex64 are the target's spectra x, ``label`` (n, half) is the conjugate of
    the label over n², ``power`` (n, half) is Σ|x|²/n², and ``filters`` are the masked filter g of the last iteration.
    ``unmasked`` is what g was masked from at the penalty ``last_penalty``, and becomes
    x·label + γg − x·t / (γ + power) with t = Σ conj(x)·(x·label + γg − h) / n² (Sherman–Morrison), where
    h = ``unmasked`` − last_penalty·g is the multiplier.
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
