"""Element-wise loops of the correlation filters, over half spectra ``(channels, n, n // 2 + 1)`` complex64.

The frequencies do not depend on each other, so each loop runs over all frequencies of a channel.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def correlate(filters, spectra, first, last, response_f):  # type: ignore[no-untyped-def]
    """Sum conj(filter) · spectrum over the channels ``first`` to ``last`` - 1 into ``response_f`` (n, n // 2 + 1)."""
    total = response_f.ravel()
    total[:] = 0
    for channel in range(first, last):
        w, z = filters[channel].ravel(), spectra[channel].ravel()
        for k in range(total.size):
            total[k] += np.conj(w[k]) * z[k]


@kernel
def respond_filters(numerator, quotient, blocks, background, spectra, response_f):  # type: ignore[no-untyped-def]
    """Apply every template filter (equation 3): write ``response_f`` (models, n, n // 2 + 1) complex64.

    ``blocks`` (ridge models, 2) int64 holds the first and one past the last channel of each ridge filter. Such a
    filter is ``numerator`` times ``quotient``. ``background`` is the filter of the last model; it has no channels if
    there is no such model.
    """
    for m in range(blocks.shape[0]):
        correlate(numerator, spectra, blocks[m, 0], blocks[m, 1], response_f[m])
        total, factor = response_f[m].ravel(), quotient[m].ravel()
        for k in range(total.size):
            total[k] *= factor[k]
    if background.shape[0] > 0:
        correlate(background, spectra, 0, spectra.shape[0], response_f[-1])


@kernel
def divide_label(label_f, denominator, regularization, quotient):  # type: ignore[no-untyped-def]
    """Divide the label by the denominator of equation 2: ``quotient`` (models, n, half) ← label / (denominator + λ)."""
    label = label_f.ravel()
    for m in range(quotient.shape[0]):
        total, row = denominator[m].ravel(), quotient[m].ravel()
        for k in range(label.size):
            row[k] = label[k] * (np.float32(1) / (total[k] + regularization))


@kernel
def energy(spectra, block, out):  # type: ignore[no-untyped-def]
    """Sum |spectrum|² over the channels of a block into ``out`` (n, n // 2 + 1) float32: equation 2's denominator."""
    total = out.ravel()
    total[:] = 0
    for channel in range(block[0], block[1]):
        z = spectra[channel].ravel()
        for k in range(total.size):
            total[k] += z[k].real * z[k].real + z[k].imag * z[k].imag


@kernel
def phase_shift(spectra, dx, dy):  # type: ignore[no-untyped-def]
    """Shift the content of ``spectra`` by (-dx, -dy) cells in place, by the shift theorem."""
    channels, n, half = spectra.shape
    unit = 2 * np.pi / n
    columns = np.empty(half, np.complex64)
    for k in range(half):
        columns[k] = np.complex64(complex(np.cos(unit * dx * k), np.sin(unit * dx * k)))
    phase = np.empty((n, half), np.complex64)
    for i in range(n):
        angle = unit * dy * (i if 2 * i < n else i - n)
        row = np.complex64(complex(np.cos(angle), np.sin(angle)))
        for k in range(half):
            phase[i, k] = row * columns[k]
    factor = phase.ravel()
    for channel in range(channels):
        z = spectra[channel].ravel()
        for k in range(factor.size):
            z[k] *= factor[k]


@kernel
def learn_filters(spectra, label_f, blocks, regularization, rate, energies, filters):  # type: ignore[no-untyped-def]
    """Average the filters of this frame alone into ``filters`` (equations 2 and 11 to the letter).

    ``energies`` (models, n, n // 2 + 1) float32 holds :func:`energy` of each block.
    """
    keep = np.float32(1) - rate
    label = label_f.ravel()
    factor = np.empty(label.size, np.complex64)
    for m in range(blocks.shape[0]):
        total = energies[m].ravel()
        for k in range(label.size):
            factor[k] = np.conj(label[k]) * (rate / (total[k] + regularization))
        for channel in range(blocks[m, 0], blocks[m, 1]):
            w, z = filters[channel].ravel(), spectra[channel].ravel()
            for k in range(label.size):
                w[k] = keep * w[k] + factor[k] * z[k]


@kernel
def learn_spectra(spectra, blocks, rate, numerator, denominator):  # type: ignore[no-untyped-def]
    """Average ``spectra`` into ``numerator`` and their energy into ``denominator`` (equation 11).

    ``numerator`` is that of equation 2 without the label, which is the same in every frame.
    """
    keep = np.float32(1) - rate
    for m in range(blocks.shape[0]):
        total = denominator[m].ravel()
        for k in range(total.size):
            total[k] *= keep
        for channel in range(blocks[m, 0], blocks[m, 1]):
            a, z = numerator[channel].ravel(), spectra[channel].ravel()
            for k in range(total.size):
                a[k] = keep * a[k] + rate * z[k]
                total[k] += rate * (z[k].real * z[k].real + z[k].imag * z[k].imag)


@kernel
def learn_shifted_spectra(  # type: ignore[no-untyped-def]
    spectra, dx, dy, blocks, rate, label_f, regularization, numerator, denominator, quotient
):
    """Call :func:`phase_shift`, :func:`learn_spectra` and :func:`divide_label`."""
    if dx != 0 or dy != 0:
        phase_shift(spectra, dx, dy)
    learn_spectra(spectra, blocks, rate, numerator, denominator)
    divide_label(label_f, denominator, regularization, quotient)
