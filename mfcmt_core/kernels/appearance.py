"""What a box looks like at a fixed small size, and how alike two such looks are.

A look is one vector, ``(LENGTH,)`` float32, of two parts of norm 1: gradient histograms of 8×8 cells of 4×4 pixels in 9
directions, normalised over 3×3 cells; and the square roots of a histogram of 8×8×8 colors. The likeness of two looks in
one part is their dot product, from 0 to 1.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel
from .hog import direction

SIDE = 32
CELLS = 8
DIRECTIONS = 9
PIXELS = SIDE * SIDE
GRADIENTS = CELLS * CELLS * DIRECTIONS
COLORS = 512
LENGTH = GRADIENTS + COLORS
EPSILON = np.float32(100)
"""Energy added to each block of gradients, in squared gray levels times pixels: noise stays small."""
FLAT = np.float32(1e-3)
"""Norm below which the gradients have no content; they are all zeros then and like nothing."""


@kernel
def take_pixels(gray, left, top, width, height, pixels):  # type: ignore[no-untyped-def]
    """``pixels`` (32, 32) float32 ← the box in ``gray`` (H, W) uint8, bilinear, the border repeated."""
    rows, columns = gray.shape
    step_x, step_y = np.float32(width / SIDE), np.float32(height / SIDE)
    x0 = np.empty(SIDE, np.int64)
    x1 = np.empty(SIDE, np.int64)
    part = np.empty(SIDE, np.float32)
    for j in range(SIDE):
        x = min(max(np.float32(left - 0.5) + (np.float32(j) + np.float32(0.5)) * step_x, 0), columns - 1)
        x0[j] = np.int64(x)
        x1[j] = min(x0[j] + 1, columns - 1)
        part[j] = np.float32(x - x0[j])
    for i in range(SIDE):
        y = min(max(np.float32(top - 0.5) + (np.float32(i) + np.float32(0.5)) * step_y, 0), rows - 1)
        y0 = np.int64(y)
        above, below = gray[y0], gray[min(y0 + 1, rows - 1)]
        down = np.float32(y - y0)
        for j in range(SIDE):
            a0, a1 = np.float32(above[x0[j]]), np.float32(above[x1[j]])
            b0, b1 = np.float32(below[x0[j]]), np.float32(below[x1[j]])
            upper = a0 + part[j] * (a1 - a0)
            lower = b0 + part[j] * (b1 - b0)
            pixels[i, j] = upper + down * (lower - upper)


@kernel
def describe_gradients(pixels, out):  # type: ignore[no-untyped-def]
    """``out`` (8, 8, 9) float32 ← the gradients of ``pixels`` (32, 32), normalised by block and as a whole."""
    out[:] = 0
    for i in range(SIDE):
        above, row, below = pixels[max(i - 1, 0)], pixels[i], pixels[min(i + 1, SIDE - 1)]
        for j in range(SIDE):
            dx = row[min(j + 1, SIDE - 1)] - row[max(j - 1, 0)]
            dy = below[j] - above[j]
            out[i >> 2, j >> 2, direction(dx, dy) >> 1] += np.sqrt(dx * dx + dy * dy)
    energy = np.empty((CELLS, CELLS), np.float32)
    for i in range(CELLS):
        for j in range(CELLS):
            total = np.float32(0)
            for k in range(DIRECTIONS):
                total += out[i, j, k] * out[i, j, k]
            energy[i, j] = total
    norm = np.float32(0)
    for i in range(CELLS):
        for j in range(CELLS):
            block = EPSILON
            for y in range(i - 1, i + 2):
                for x in range(j - 1, j + 2):
                    block += energy[min(max(y, 0), CELLS - 1), min(max(x, 0), CELLS - 1)]
            inverse = np.float32(1) / np.sqrt(block)
            for k in range(DIRECTIONS):
                out[i, j, k] *= inverse
                norm += out[i, j, k] * out[i, j, k]
    norm = np.sqrt(norm)
    inverse = np.float32(1) / norm if norm > FLAT else np.float32(0)
    out *= inverse


@kernel
def describe_colors(bins, channels, left, top, width, height, out):  # type: ignore[no-untyped-def]
    """``out`` (512,) float32 ← square roots of the shares of 8 levels a channel among 32×32 pixels of the box.

    ``bins`` (H, W) uint16 holds 5 bits of each of 1 or 3 ``channels``.
    """
    rows, columns = bins.shape
    out[:] = 0
    one = np.float32(1 / PIXELS)
    for i in range(SIDE):
        row = bins[min(max(np.int64(top + (i + 0.5) * height / SIDE), 0), rows - 1)]
        for j in range(SIDE):
            bin_ = np.int64(row[min(max(np.int64(left + (j + 0.5) * width / SIDE), 0), columns - 1)])
            color = (bin_ >> 2) & 7
            if channels == 3:
                color |= ((bin_ >> 4) & 0o70) | ((bin_ >> 6) & 0o700)
            out[color] += one
    for k in range(COLORS):
        out[k] = np.sqrt(out[k])


@kernel
def describe_box(gray, bins, channels, left, top, width, height, look):  # type: ignore[no-untyped-def]
    """``look`` ← the box, in pixels of ``gray`` and ``bins``. Returns the standard deviation of its gray pixels."""
    pixels = np.empty((SIDE, SIDE), np.float32)
    take_pixels(gray, left, top, width, height, pixels)
    describe_gradients(pixels, look[:GRADIENTS].reshape(CELLS, CELLS, DIRECTIONS))
    describe_colors(bins, channels, left, top, width, height, look[GRADIENTS:])
    total, squares = np.float32(0), np.float32(0)
    for i in range(SIDE):
        for j in range(SIDE):
            level = pixels[i, j] - pixels[0, 0]
            total += level
            squares += level * level
    mean = total / np.float32(PIXELS)
    return np.sqrt(max(np.float64(squares / np.float32(PIXELS) - mean * mean), 0.0))


@kernel
def compare_box(gray, bins, channels, left, top, width, height, first, look):  # type: ignore[no-untyped-def]
    """``look`` ← the box. Returns the deviation of its gray pixels, and three likenesses.

    These are that of its gradients to those of ``first``, of its colors to those of ``first``, and of its colors to
    those beside it: the mean over the boxes of its size on its four sides.
    """
    deviation = describe_box(gray, bins, channels, left, top, width, height, look)
    gradients, colors = np.float32(0), np.float32(0)
    for k in range(GRADIENTS):
        gradients += look[k] * first[k]
    for k in range(GRADIENTS, LENGTH):
        colors += look[k] * first[k]
    beside = np.float32(0)
    neighbor = np.empty(COLORS, np.float32)
    for side in range(4):
        step = np.float64(side // 2 * 2 - 1)
        x, y = (step * width, 0.0) if side % 2 else (0.0, step * height)
        describe_colors(bins, channels, left + x, top + y, width, height, neighbor)
        for k in range(COLORS):
            beside += neighbor[k] * look[GRADIENTS + k]
    return deviation, np.float64(gradients), np.float64(colors), np.float64(beside / 4)


@kernel
def deviation_of_cells(gray):  # type: ignore[no-untyped-def]
    """Standard deviation of the means of cells of 4×4 of ``gray`` (H, W) uint8, in gray levels: noise averages out."""
    rows, columns = gray.shape[0] // 4, gray.shape[1] // 4
    total, squares = 0.0, 0.0
    for i in range(rows):
        for j in range(columns):
            cell = np.int32(0)
            for y in range(4 * i, 4 * i + 4):
                for x in range(4 * j, 4 * j + 4):
                    cell += np.int32(gray[y, x])
            mean = cell / 16.0
            total += mean
            squares += mean * mean
    count = max(rows * columns, 1)
    return np.sqrt(max(squares / count - (total / count) ** 2, 0.0))
