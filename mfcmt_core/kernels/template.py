"""Element-wise passes of the correlation filters, over half spectra ``(channels, n, n // 2 + 1)`` complex64."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def respond_filters(filters, spectra, blocks, response_f):  # type: ignore[no-untyped-def]
    """Equation 3: ``response_f[m]`` ← Σ conj(filter) · spectrum over the channels of block m.

    ``blocks`` (models, 2) int64 holds each model's first and one past its last channel.
    """
    _, rows, columns = spectra.shape
    for m in range(blocks.shape[0]):
        total = response_f[m]
        total[:] = 0
        for channel in range(blocks[m, 0], blocks[m, 1]):
            for i in range(rows):
                for k in range(columns):
                    total[i, k] += np.conj(filters[channel, i, k]) * spectra[channel, i, k]


@kernel
def energy(spectra, block, out):  # type: ignore[no-untyped-def]
    """Σ |spectrum|² over the channels of a block, ``out`` (n, n // 2 + 1) float32: equation 2's denominator."""
    out[:] = 0
    for channel in range(block[0], block[1]):
        for i in range(out.shape[0]):
            for k in range(out.shape[1]):
                z = spectra[channel, i, k]
                out[i, k] += z.real * z.real + z.imag * z.imag


@kernel
def learn_filters(spectra, label_f, blocks, regularization, rate, energies, filters):  # type: ignore[no-untyped-def]
    """Equations 2 and 11 to the letter: filters of this frame alone, averaged into ``filters``.

    ``energies`` (models, n, n // 2 + 1) float32 holds :func:`energy` of each block.
    """
    keep = np.float32(1) - rate
    for m in range(blocks.shape[0]):
        for channel in range(blocks[m, 0], blocks[m, 1]):
            for i in range(label_f.shape[0]):
                for k in range(label_f.shape[1]):
                    gain = rate / (energies[m, i, k] + regularization)
                    new = np.conj(label_f[i, k]) * spectra[channel, i, k] * gain
                    filters[channel, i, k] = keep * filters[channel, i, k] + new


@kernel
def learn_spectra(  # type: ignore[no-untyped-def]
    spectra, label_f, blocks, regularization, rate, energies, numerator, denominator, filters
):
    """Equation 11 on numerator and denominator of equation 2, then the division: ``filters``."""
    keep = np.float32(1) - rate
    for m in range(blocks.shape[0]):
        for i in range(label_f.shape[0]):
            for k in range(label_f.shape[1]):
                denominator[m, i, k] = keep * denominator[m, i, k] + rate * energies[m, i, k]
        for channel in range(blocks[m, 0], blocks[m, 1]):
            for i in range(label_f.shape[0]):
                for k in range(label_f.shape[1]):
                    new = np.conj(label_f[i, k]) * spectra[channel, i, k] * rate
                    numerator[channel, i, k] = keep * numerator[channel, i, k] + new
                    filters[channel, i, k] = numerator[channel, i, k] / (denominator[m, i, k] + regularization)


@kernel
def center_response(response, out):  # type: ignore[no-untyped-def]
    """The displacements within reach, zero in the middle: ``out`` (2·ry + 1, 2·rx + 1) ← ``response`` (n, n).

    Returns the highest value.
    """
    rows, columns = out.shape
    n_rows, n_columns = response.shape
    highest = np.float32(-np.inf)
    for i in range(rows):
        source = response[(i - rows // 2) % n_rows]
        for j in range(columns):
            v = source[(j - columns // 2) % n_columns]
            out[i, j] = v
            highest = max(highest, v)
    return highest
