"""Turn response maps into probability maps and fuse them. A map has a few hundred cells, so plain loops suffice."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def fuse_maps(responses, weights, floor, power, tops, fused):  # type: ignore[no-untyped-def]
    """Turn ``responses`` (maps, rows, columns) into probability maps in place, and write their mean to ``fused``.

    ``tops`` (maps,) float32 receives the highest value of each response.

    ``floor`` 0 clips negative values, 1 subtracts the minimum, 2 leaves the responses as they are. Unless ``floor``
    is 2, each map is then raised to ``power`` and divided by its sum. A flat map becomes uniform.
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
    """Return ``(row, column, height, psr)`` of the highest cell. A parabola refines row and column.

    The peak-to-sidelobe ratio is (height - mean) / standard deviation, over the cells that are more than
    ``leave_out`` rows or columns from the peak. It is 0 if there are none or they are all equal.
    """
    rows, columns = fused.shape
    pi, pj = rows // 2, columns // 2  # the peak of a flat map is its middle
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
    """Call :func:`fuse_maps`, then return :func:`find_peak` of the fused map."""
    fuse_maps(responses, weights, floor, power, tops, fused)
    return find_peak(fused, leave_out)


@kernel
def second_peak_ratio(fused, leave_out):  # type: ignore[no-untyped-def]
    """Return the second peak of a map over its first, which lies more than ``leave_out`` cells away; 1 for none."""
    rows, columns = fused.shape
    pi, pj = 0, 0
    for i in range(rows):
        for j in range(columns):
            if fused[i, j] > fused[pi, pj]:
                pi, pj = i, j
    second = np.float32(0)
    for i in range(rows):
        for j in range(columns):
            if abs(i - pi) > leave_out or abs(j - pj) > leave_out:
                second = max(second, fused[i, j])
    return np.float64(second / fused[pi, pj]) if fused[pi, pj] > 0 else 1.0
