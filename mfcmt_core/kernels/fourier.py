"""The steps of the transforms that are not matrix products."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def fold_rows(grids, even, odd):  # type: ignore[no-untyped-def]
    """Write the sums of the rows k and n - k of ``grids`` (n, columns) to ``even``, their differences to ``odd``.

    ``even`` (n // 2 + 1, columns) has the rows that are their own opposite unchanged. ``odd`` starts at k = 1.
    """
    n, columns = grids.shape
    even[0] = grids[0]
    for k in range(1, n // 2 + 1):
        row, opposite, total = grids[k], grids[n - k], even[k]
        if 2 * k == n:
            total[:] = row
        else:
            difference = odd[k - 1]
            for i in range(columns):
                total[i] = row[i] + opposite[i]
                difference[i] = row[i] - opposite[i]


@kernel
def assemble(products, out):  # type: ignore[no-untyped-def]
    """Assemble half spectra ``out`` (channels, n, half) complex64 from their cosine and sine sums.

    ``products`` is (n, channels, ≥ 2 · half) float32. Its rows are the cosine sums from frequency 0, then the sine
    sums from frequency 1; its columns are ``half`` cosine sums, then ``half`` sine sums.
    """
    channels, n, half = out.shape
    for channel in range(channels):
        for i in range(half):
            cosine, positive = products[i, channel], out[channel, i]
            if i == 0 or 2 * i == n:
                for k in range(half):
                    positive[k] = np.complex64(complex(cosine[k], -cosine[half + k]))
            else:
                sine, negative = products[half + i - 1, channel], out[channel, n - i]
                for k in range(half):
                    a, b, c, d = cosine[k], cosine[half + k], sine[k], sine[half + k]
                    positive[k] = np.complex64(complex(a - d, -b - c))
                    negative[k] = np.complex64(complex(a + d, c - b))
