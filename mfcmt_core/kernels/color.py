"""Colour histograms, their per-pixel look-up, and the sums of an integral image."""

from __future__ import annotations

import numpy as np

from ._jit import kernel

SEEN = 1e-12
"""Part of a region from which on a colour counts as seen."""
FORGOTTEN = 1e-20


@kernel
def bin_pixels(patch, bins):  # type: ignore[no-untyped-def]
    """Index of each pixel's cell of the 32×32×32 RGB cube: ``bins`` (H, W) uint16 ← ``patch`` (H, W, 3) BGR."""
    height, width = bins.shape
    for y in range(height):
        for x in range(width):
            bins[y, x] = (
                (np.int32(patch[y, x, 2]) >> 3)
                | ((np.int32(patch[y, x, 1]) >> 3) << 5)
                | ((np.int32(patch[y, x, 0]) >> 3) << 10)
            )


@kernel
def bin_gray(patch, bins):  # type: ignore[no-untyped-def]
    """Index of each grey pixel among 32 bins: ``bins`` (H, W) uint16 ← ``patch`` (H, W) uint8."""
    height, width = bins.shape
    for y in range(height):
        for x in range(width):
            bins[y, x] = np.int32(patch[y, x]) >> 3


@kernel
def learn_colors(bins, inner, outer, rate, counts, foreground, background):  # type: ignore[no-untyped-def]
    """Equation 11: the histograms move by ``rate`` towards those of the two regions of a patch, each of sum 1.

    ``inner`` and ``outer`` are ``(top, left, bottom, right)``: pixels inside ``inner`` are foreground, those
    outside ``outer`` background, those between neither. ``counts`` (2, bins) int32 is zero, before and after.
    """
    height, width = bins.shape
    count_f, count_b = counts[0], counts[1]
    for y in range(height):
        row = bins[y]
        if inner[0] <= y < inner[2]:
            for x in range(inner[1], inner[3]):
                count_f[row[x]] += 1
        within = outer[0] <= y < outer[2]
        for x in range(outer[1] if within else width):
            count_b[row[x]] += 1
        for x in range(outer[3] if within else width, width):
            count_b[row[x]] += 1
    area_f = max((inner[2] - inner[0]) * (inner[3] - inner[1]), 1)
    area_b = max(height * width - (outer[2] - outer[0]) * (outer[3] - outer[1]), 1)
    one_f, one_b = rate / np.float32(area_f), rate / np.float32(area_b)
    keep, nothing = np.float32(1) - rate, np.float32(FORGOTTEN)
    for i in range(foreground.size):  # what has faded is dropped before it gets denormal, which is slow
        f = keep * foreground[i] + one_f * np.float32(count_f[i])
        b = keep * background[i] + one_b * np.float32(count_b[i])
        foreground[i] = f if f > nothing else np.float32(0)
        background[i] = b if b > nothing else np.float32(0)
        count_f[i] = 0
        count_b[i] = 0


@kernel
def tabulate(foreground, background, unseen, lookup):  # type: ignore[no-untyped-def]
    """Equation 6: ``lookup`` ← F / (F + B), and ``unseen`` for bins that neither region has shown."""
    for i in range(lookup.size):
        total = foreground[i] + background[i]
        lookup[i] = foreground[i] / total if total > np.float32(SEEN) else unseen


@kernel
def look_up(bins, lookup, integral):  # type: ignore[no-untyped-def]
    """Per-pixel likelihood summed up: ``integral`` (H + 1, W + 1) float32, the recursion of equation 7."""
    height, width = bins.shape
    integral[0, :] = 0
    for y in range(height):
        integral[y + 1, 0] = 0
        total = np.float32(0)
        for x in range(width):
            total += lookup[bins[y, x]]
            integral[y + 1, x + 1] = integral[y, x + 1] + total


@kernel
def box_means(integral, rows, columns, box_height, box_width, out):  # type: ignore[no-untyped-def]
    """Mean over a box at each placement: four corners of the integral image (equation 7).

    ``rows`` and ``columns`` are the tops and lefts of the boxes; ``out`` (len(rows), len(columns)) float32.
    """
    scale = np.float32(1) / np.float32(box_height * box_width)
    for i in range(rows.size):
        top, bottom = integral[rows[i]], integral[rows[i] + box_height]
        for j in range(columns.size):
            left, right = columns[j], columns[j] + box_width
            out[i, j] = (bottom[right] - bottom[left] - top[right] + top[left]) * scale
