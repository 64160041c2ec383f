"""Means over cells: raw pixels and colour names."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def gray_cells(gray, window, out):  # type: ignore[no-untyped-def]
    """Mean grey of each cell of 4×4 in [-0.5, 0.5], windowed: ``out`` (cells, cells) ← ``gray`` uint8."""
    cells_y, cells_x = out.shape
    scale, half = np.float32(1 / (16 * 255)), np.float32(0.5)
    for cy in range(cells_y):
        for cx in range(cells_x):
            total = np.int32(0)
            for y in range(4 * cy, 4 * cy + 4):
                for x in range(4 * cx, 4 * cx + 4):
                    total += np.int32(gray[y, x])
            out[cy, cx] = (np.float32(total) * scale - half) * window[cy, cx]


@kernel
def color_name_cells(means, table, window, out):  # type: ignore[no-untyped-def]
    """Colour-name features of each cell's mean colour, windowed.

    ``means`` (cells, cells, 3) uint8 BGR, ``table`` (32768, L) float32, ``out`` (L, cells, cells).
    """
    channels, cells_y, cells_x = out.shape
    for cy in range(cells_y):
        for cx in range(cells_x):
            index = (
                (np.int32(means[cy, cx, 2]) >> 3)
                | ((np.int32(means[cy, cx, 1]) >> 3) << 5)
                | ((np.int32(means[cy, cx, 0]) >> 3) << 10)
            )
            w = window[cy, cx]
            for channel in range(channels):
                out[channel, cy, cx] = table[index, channel] * w
