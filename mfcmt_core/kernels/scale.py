"""Samples of the scale filter: one small patch a scale, all scales side by side in SIMD lanes.

Arrays end in the axis of scales, so that every inner loop runs over scales. With m steps to each side, padded
to M lanes, its order is m smaller ones by distance, m larger ones by distance (each padded to M): scales at the
same distance face each other, and even and odd parts are sums and differences of lanes. The present scale is in
the padding behind the smaller ones, or where there is none behind all others.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel
from .hog import CHANNELS, CLIP, ORIENTATIONS, SIGNED, TEXTURE, direction


@kernel
def pack_quads(gray, quads):  # type: ignore[no-untyped-def]
    """Each pixel with its right, lower and lower right neighbour in one word: ``quads`` (H, W) uint32 ← ``gray``.

    The border repeats. Interpolation then needs one load a sample instead of four.
    """
    height, width = gray.shape
    for y in range(height):
        top, bottom, out = gray[y], gray[min(y + 1, height - 1)], quads[y]
        for x in range(width - 1):
            upper = np.uint32(top[x]) | (np.uint32(top[x + 1]) << np.uint32(8))
            lower = np.uint32(bottom[x]) | (np.uint32(bottom[x + 1]) << np.uint32(8))
            out[x] = upper | (lower << np.uint32(16))
        out[width - 1] = np.uint32(top[width - 1]) * np.uint32(0x101) + np.uint32(bottom[width - 1]) * np.uint32(
            0x1010000
        )


@kernel
def sample_scales(quads, center_x, center_y, step_x, step_y, out):  # type: ignore[no-untyped-def]
    """Bilinear samples of a grey picture around a centre, one grid of steps a scale.

    ``quads`` (H, W) is the picture as :func:`pack_quads` leaves it; ``step_x``, ``step_y`` (lanes,) float32 are
    the distances of neighbouring samples in its pixels; ``out`` (h, w, lanes) float32. Beyond the border the
    nearest pixel repeats.
    """
    height, width, lanes = out.shape
    zero, half, byte = np.float32(0), np.float32(0.5), np.uint32(255)
    last_x, last_y = np.float32(quads.shape[1] - 1), np.float32(quads.shape[0] - 1)
    flat, row_length = quads.ravel(), np.int32(quads.shape[1])
    column, part_x = np.empty((width, lanes), np.int32), np.empty((width, lanes), np.float32)
    for j in range(width):
        offset = np.float32(j) + half - half * np.float32(width)
        for s in range(lanes):
            x = min(max(center_x + offset * step_x[s] - half, zero), last_x)
            column[j, s] = np.int32(x)
            part_x[j, s] = x - np.float32(np.int32(x))
    row, part_y = np.empty(lanes, np.int32), np.empty(lanes, np.float32)
    for i in range(height):
        offset = np.float32(i) + half - half * np.float32(height)
        for s in range(lanes):
            y = min(max(center_y + offset * step_y[s] - half, zero), last_y)
            row[s] = np.int32(y) * row_length
            part_y[s] = y - np.float32(np.int32(y))
        for j in range(width):
            target, columns, parts = out[i, j], column[j], part_x[j]
            for s in range(lanes):
                quad = flat[row[s] + columns[s]]
                top_left = np.float32(np.int32(quad & byte))
                top_right = np.float32(np.int32((quad >> np.uint32(8)) & byte))
                bottom_left = np.float32(np.int32((quad >> np.uint32(16)) & byte))
                bottom_right = np.float32(np.int32(quad >> np.uint32(24)))
                top = top_left + parts[s] * (top_right - top_left)
                bottom = bottom_left + parts[s] * (bottom_right - bottom_left)
                target[s] = top + part_y[s] * (bottom - top)


@kernel
def scale_histogram(samples, count, histogram):  # type: ignore[no-untyped-def]
    """Bilinear votes of the first ``count`` lanes of ``samples`` (h, w, lanes) into cells of 4×4.

    ``histogram`` (h/4 · w/4 + 1, 18, lanes) float32, its last cell for what falls outside the grid.
    """
    height, width, lanes = samples.shape
    cells_y, cells_x = height // 4, width // 4
    outside = cells_y * cells_x
    histogram[:] = 0
    fractions = (np.float32(0.625), np.float32(0.875), np.float32(0.125), np.float32(0.375))
    one = np.float32(1)
    magnitude, orientation = np.empty(lanes, np.float32), np.empty(lanes, np.uint8)
    for y in range(height):
        above, row, below = samples[max(y - 1, 0)], samples[y], samples[min(y + 1, height - 1)]
        cy, lower = (y + 2) // 4, fractions[y % 4]  # votes go to cells cy - 1 and cy
        upper = one - lower
        for x in range(width):
            left, right, up, down = row[max(x - 1, 0)], row[min(x + 1, width - 1)], above[x], below[x]
            for s in range(lanes):
                dx, dy = right[s] - left[s], down[s] - up[s]
                magnitude[s] = np.sqrt(dx * dx + dy * dy)
                orientation[s] = direction(dx, dy)
            cx, after = (x + 2) // 4, fractions[x % 4]
            before = one - after
            a = histogram[(cy - 1) * cells_x + cx - 1 if cy > 0 and cx > 0 else outside]
            b = histogram[(cy - 1) * cells_x + cx if cy > 0 and cx < cells_x else outside]
            c = histogram[cy * cells_x + cx - 1 if cy < cells_y and cx > 0 else outside]
            d = histogram[cy * cells_x + cx if cy < cells_y and cx < cells_x else outside]
            for s in range(count):
                o, vote = orientation[s], magnitude[s]
                a[o, s] += upper * before * vote
                b[o, s] += upper * after * vote
                c[o, s] += lower * before * vote
                d[o, s] += lower * after * vote


@kernel
def scale_norms(histogram, epsilon, norms):  # type: ignore[no-untyped-def]
    """One over the energy's root of each block of 2×2 cells: ``norms`` (cells_y + 1, cells_x + 1, lanes)."""
    cells_y, cells_x, lanes = norms.shape[0] - 1, norms.shape[1] - 1, norms.shape[2]
    energy = np.zeros((cells_y, cells_x, lanes), np.float32)
    for cy in range(cells_y):
        for cx in range(cells_x):
            cell, total = histogram[cy * cells_x + cx], energy[cy, cx]
            for o in range(ORIENTATIONS):
                first, second = cell[o], cell[o + ORIENTATIONS]
                for s in range(lanes):
                    total[s] += (first[s] + second[s]) ** 2
    for by in range(cells_y + 1):
        for bx in range(cells_x + 1):
            a = energy[max(by - 1, 0), max(bx - 1, 0)]
            b = energy[max(by - 1, 0), min(bx, cells_x - 1)]
            c = energy[min(by, cells_y - 1), max(bx - 1, 0)]
            d = energy[min(by, cells_y - 1), min(bx, cells_x - 1)]
            out = norms[by, bx]
            for s in range(lanes):
                out[s] = np.float32(1) / np.sqrt(a[s] + b[s] + c[s] + d[s] + epsilon)


@kernel
def scale_features(histogram, norms, window, present, even, odd):  # type: ignore[no-untyped-def]
    """fHOG of every scale times the window over scales, as even and odd part along scales.

    ``window`` (lanes,) has equal values at equal distances; ``even`` (cells · 31, M + 1) gets the scale of lane
    ``present`` and the sums, ``odd`` (cells · 31, M) the differences larger - smaller.
    """
    cells_y, cells_x, lanes = norms.shape[0] - 1, norms.shape[1] - 1, norms.shape[2]
    half = np.float32(0.5)
    feature = np.empty(lanes, np.float32)
    texture = np.empty((4, lanes), np.float32)
    t0, t1, t2, t3 = texture[0], texture[1], texture[2], texture[3]
    for cy in range(cells_y):
        for cx in range(cells_x):
            cell, base = histogram[cy * cells_x + cx], (cy * cells_x + cx) * CHANNELS
            a, b = norms[cy, cx], norms[cy, cx + 1]
            c, d = norms[cy + 1, cx], norms[cy + 1, cx + 1]
            texture[:] = 0
            for o in range(SIGNED):
                h = cell[o]
                for s in range(lanes):
                    va, vb = min(h[s] * a[s], CLIP), min(h[s] * b[s], CLIP)
                    vc, vd = min(h[s] * c[s], CLIP), min(h[s] * d[s], CLIP)
                    t0[s] += va
                    t1[s] += vb
                    t2[s] += vc
                    t3[s] += vd
                    feature[s] = half * window[s] * (va + vb + vc + vd)
                fold(feature, present, even[base + o], odd[base + o])
            for o in range(ORIENTATIONS):
                first, second = cell[o], cell[o + ORIENTATIONS]
                for s in range(lanes):
                    v = first[s] + second[s]
                    total = min(v * a[s], CLIP) + min(v * b[s], CLIP) + min(v * c[s], CLIP) + min(v * d[s], CLIP)
                    feature[s] = half * window[s] * total
                fold(feature, present, even[base + SIGNED + o], odd[base + SIGNED + o])
            for k in range(4):
                t = texture[k]
                for s in range(lanes):
                    feature[s] = TEXTURE * window[s] * t[s]
                channel = base + SIGNED + ORIENTATIONS + k
                fold(feature, present, even[channel], odd[channel])


@kernel
def fold(values, present, even, odd):  # type: ignore[no-untyped-def]
    """Present value and sums into ``even`` (M + 1,), differences into ``odd`` (M,)."""
    side = odd.size
    even[0] = values[present]
    for j in range(side):
        even[1 + j] = values[side + j] + values[j]
        odd[j] = values[side + j] - values[j]


@kernel
def scale_hog(  # type: ignore[no-untyped-def]
    gray, center_x, center_y, step_x, step_y, present, epsilon, window, quads, samples, histogram, norms, even, odd
):
    """From a grey picture to the features of every scale in one call; scratch as its parts want it."""
    pack_quads(gray, quads)
    sample_scales(quads, center_x, center_y, step_x, step_y, samples)
    scale_histogram(samples, max(present + 1, 2 * odd.shape[1]), histogram)
    scale_norms(histogram, epsilon, norms)
    scale_features(histogram, norms, window, present, even, odd)


@kernel
def respond_scales(  # type: ignore[no-untyped-def]
    spectra, sums, mean, mean_sums, label_f, energy, regularization, response_f
):
    """Equation 3 along scales: Σ over features of conj(mean) · spectrum · label / (energy + λ).

    ``spectra`` (features, 2 M) float32 holds M cosine sums and M sine sums of each feature, ``sums`` (features,)
    frequency 0, and so do the means; ``label_f`` and ``energy`` (M + 1,) have frequency 0 last.
    ``response_f`` (2 M + 1,): M cosine, M sine sums and frequency 0 of the response.
    """
    side = response_f.size // 2
    real, imaginary, constant = np.zeros(side, np.float32), np.zeros(side, np.float32), np.float32(0)
    for d in range(spectra.shape[0]):
        z, a = spectra[d], mean[d]
        for k in range(side):
            real[k] += a[k] * z[k] + a[side + k] * z[side + k]
            imaginary[k] += a[k] * z[side + k] - a[side + k] * z[k]
        constant += mean_sums[d] * sums[d]
    for k in range(side):
        gain = label_f[k] / (energy[k] + regularization)
        response_f[k] = real[k] * gain
        response_f[side + k] = imaginary[k] * gain
    response_f[2 * side] = constant * label_f[side] / (energy[side] + regularization)


@kernel
def learn_scales(spectra, sums, angles, rate, mean, mean_sums, energy):  # type: ignore[no-untyped-def]
    """Running means of the spectra, as :func:`respond_scales` takes them, and of their energy.

    Each frequency is turned by its angle of ``angles`` (M,), which moves the spectra along the scales. ``energy``
    (M + 1,) is Σ |spectrum|² over features, frequency 0 last.
    """
    side = energy.size - 1
    keep = np.float32(1) - rate
    cosines, sines = np.cos(angles), np.sin(angles)
    squares, constant = np.zeros(side, np.float32), np.float32(0)
    for d in range(spectra.shape[0]):
        z, a = spectra[d], mean[d]
        for k in range(side):
            real, imaginary, c, s = z[k], z[side + k], cosines[k], sines[k]
            squares[k] += real * real + imaginary * imaginary
            a[k] = keep * a[k] + rate * (real * c + imaginary * s)
            a[side + k] = keep * a[side + k] + rate * (imaginary * c - real * s)
        constant += sums[d] * sums[d]
        mean_sums[d] = keep * mean_sums[d] + rate * sums[d]
    for k in range(side):
        energy[k] = keep * energy[k] + rate * squares[k]
    energy[side] = keep * energy[side] + rate * constant
