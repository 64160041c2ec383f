"""Element-wise passes of the correlation filters, over half spectra ``(channels, n, n // 2 + 1)`` complex64.

Each frequency is for itself, so the loops run over all of a channel's frequencies at once.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def respond_filters(filters, spectra, blocks, response_f):  # type: ignore[no-untyped-def]
    """Equation 3: ``response_f[m]`` ← Σ conj(filter) · spectrum over the channels of block m.

    ``blocks`` (models, 2) int64 holds each model's first and one past its last channel.
    """
    for m in range(blocks.shape[0]):
        total = response_f[m].ravel()
        total[:] = 0
        for channel in range(blocks[m, 0], blocks[m, 1]):
            w, z = filters[channel].ravel(), spectra[channel].ravel()
            for k in range(total.size):
                total[k] += np.conj(w[k]) * z[k]


@kernel
def energy(spectra, block, out):  # type: ignore[no-untyped-def]
    """Σ |spectrum|² over the channels of a block, ``out`` (n, n // 2 + 1) float32: equation 2's denominator."""
    total = out.ravel()
    total[:] = 0
    for channel in range(block[0], block[1]):
        z = spectra[channel].ravel()
        for k in range(total.size):
            total[k] += z[k].real * z[k].real + z[k].imag * z[k].imag


@kernel
def learn_filters(spectra, label_f, blocks, regularization, rate, energies, filters):  # type: ignore[no-untyped-def]
    """Equations 2 and 11 to the letter: filters of this frame alone, averaged into ``filters``.

    ``energies`` (models, n, n // 2 + 1) float32 holds :func:`energy` of each block.
    """
    keep = np.float32(1) - rate
    label = label_f.ravel()
    gain = np.empty(label.size, np.complex64)
    for m in range(blocks.shape[0]):
        total = energies[m].ravel()
        for k in range(label.size):
            gain[k] = np.conj(label[k]) * (rate / (total[k] + regularization))
        for channel in range(blocks[m, 0], blocks[m, 1]):
            w, z = filters[channel].ravel(), spectra[channel].ravel()
            for k in range(label.size):
                w[k] = keep * w[k] + gain[k] * z[k]


@kernel
def learn_spectra(  # type: ignore[no-untyped-def]
    spectra, label_f, blocks, regularization, rate, energies, mean, denominator, filters
):
    """Equation 11 on numerator and denominator of equation 2, then the division: ``filters``.

    The label is the same in every frame, so the numerator's mean is the label times the ``mean`` of spectra.
    """
    keep = np.float32(1) - rate
    label = label_f.ravel()
    gain = np.empty(label.size, np.complex64)
    for m in range(blocks.shape[0]):
        total, new = denominator[m].ravel(), energies[m].ravel()
        for k in range(label.size):
            total[k] = keep * total[k] + rate * new[k]
            gain[k] = np.conj(label[k]) * (np.float32(1) / (total[k] + regularization))
        for channel in range(blocks[m, 0], blocks[m, 1]):
            w, a, z = filters[channel].ravel(), mean[channel].ravel(), spectra[channel].ravel()
            for k in range(label.size):
                a[k] = keep * a[k] + rate * z[k]
                w[k] = gain[k] * a[k]
