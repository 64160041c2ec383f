"""Features that are means over cells: raw pixels and color names.

Features are stacks of planes with their rows outermost, ``(cells, channels, cells)`` float32.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def gray_cells(gray, hann, channel, out):  # type: ignore[no-untyped-def]
    """Write the windowed mean gray of each cell of 4×4 pixels, in [-0.5, 0.5], to one plane of ``out``."""
    cells_y, _, cells_x = out.shape
    scale, half = np.float32(1 / (16 * 255)), np.float32(0.5)
    for cy in range(cells_y):
        for cx in range(cells_x):
            total = np.int32(0)
            for y in range(4 * cy, 4 * cy + 4):
                for x in range(4 * cx, 4 * cx + 4):
                    total += np.int32(gray[y, x])
            out[cy, channel, cx] = (np.float32(total) * scale - half) * hann[cy, cx]


@kernel
def color_name_cells(patch, table, hann, first, out):  # type: ignore[no-untyped-def]
    """Write the windowed color-name features of each cell's mean color to the planes of ``out`` from ``first`` on.

    ``patch`` (4 cells, 4 cells, 3) uint8 BGR, ``table`` (32768, L) float32.
    """
    cells_y, _, cells_x = out.shape
    index = np.empty(cells_x, np.int32)
    for cy in range(cells_y):
        for cx in range(cells_x):
            blue, green, red = np.int32(8), np.int32(8), np.int32(8)  # half of 16 pixels: the mean is rounded
            for y in range(4 * cy, 4 * cy + 4):
                for x in range(4 * cx, 4 * cx + 4):
                    blue += np.int32(patch[y, x, 0])
                    green += np.int32(patch[y, x, 1])
                    red += np.int32(patch[y, x, 2])
            index[cx] = (red >> 7) | ((green >> 7) << 5) | ((blue >> 7) << 10)
        for channel in range(table.shape[1]):
            plane = out[cy, first + channel]
            for cx in range(cells_x):
                plane[cx] = table[index[cx], channel] * hann[cy, cx]
