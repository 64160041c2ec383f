"""Response maps to probability maps and their fusion; the maps are a few hundred cells, so plain loops do."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def fuse_maps(responses, weights, floor, power, tops, fused):  # type: ignore[no-untyped-def]
    """``responses`` (maps, rows, columns) float32 become probability maps in place, ``fused`` their mean.

    ``tops`` (maps,) float32 gets the highest value of each before that.

    ``floor`` 0: negatives are clipped; 1: the minimum is subtracted; 2: responses stay as they are. Then
    each map is raised to ``power`` and divided by its sum, unless ``floor`` is 2. A flat map becomes uniform.
    """
    maps, rows, columns = responses.shape
    fused[:] = 0
    total_weight = np.float32(0)
    for m in range(maps):
        total_weight += weights[m]
    for m in range(maps):
        r = responses[m]
        weight = weights[m] / total_weight
        top = r[0, 0]
        for i in range(rows):
            for j in range(columns):
                top = max(top, r[i, j])
        tops[m] = top
        if floor < 2:
            low = np.float32(0)
            if floor == 1:
                low = r[0, 0]
                for i in range(rows):
                    for j in range(columns):
                        low = min(low, r[i, j])
            total = np.float32(0)
            for i in range(rows):
                for j in range(columns):
                    v = max(r[i, j] - low, np.float32(0))
                    v = v if power == 1 else v * v
                    r[i, j] = v
                    total += v
            if total > np.float32(1e-20):
                inverse = np.float32(1) / total
                for i in range(rows):
                    for j in range(columns):
                        r[i, j] *= inverse
            else:
                r[:] = np.float32(1) / np.float32(rows * columns)
        for i in range(rows):
            for j in range(columns):
                fused[i, j] += weight * r[i, j]


@kernel
def find_peak(fused, leave_out):  # type: ignore[no-untyped-def]
    """``(row, column, height, psr)`` of the highest cell, row and column refined by a parabola each.

    The peak-to-sidelobe ratio is (height - mean) / standard deviation of the cells further than
    ``leave_out`` from the peak in row or column; 0 where none are left or they are all alike.
    """
    rows, columns = fused.shape
    pi, pj = rows // 2, columns // 2  # where a flat map leaves the target
    for i in range(rows):
        for j in range(columns):
            if fused[i, j] > fused[pi, pj]:
                pi, pj = i, j
    height = fused[pi, pj]
    y, x = np.float64(pi), np.float64(pj)
    if 0 < pi < rows - 1:
        curve = fused[pi - 1, pj] - 2 * height + fused[pi + 1, pj]
        if curve < 0:
            y += min(max(0.5 * (fused[pi - 1, pj] - fused[pi + 1, pj]) / curve, -0.5), 0.5)
    if 0 < pj < columns - 1:
        curve = fused[pi, pj - 1] - 2 * height + fused[pi, pj + 1]
        if curve < 0:
            x += min(max(0.5 * (fused[pi, pj - 1] - fused[pi, pj + 1]) / curve, -0.5), 0.5)
    count, total, squares = 0, 0.0, 0.0
    for i in range(rows):
        for j in range(columns):
            if abs(i - pi) > leave_out or abs(j - pj) > leave_out:
                v = np.float64(fused[i, j]) / height if height > 0 else 0.0
                count += 1
                total += v
                squares += v * v
    psr = 0.0
    if count > 1:
        mean = total / count
        variance = squares / count - mean * mean
        if variance > 1e-12:
            psr = (1.0 - mean) / np.sqrt(variance)
    return y, x, np.float64(height), psr


@kernel
def fuse_and_find(responses, weights, floor, power, leave_out, tops, fused):  # type: ignore[no-untyped-def]
    """:func:`fuse_maps` and :func:`find_peak` in one call."""
    fuse_maps(responses, weights, floor, power, tops, fused)
    return find_peak(fused, leave_out)
