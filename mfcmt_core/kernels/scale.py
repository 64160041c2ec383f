"""The samples of the scale filter: one small patch per scale, with all scales side by side in SIMD lanes.

The last axis of every array is the scales, so that each inner loop runs over them. The caller provides the scratch
arrays: the compiler cannot know that arrays allocated in a kernel do not overlap, and would test it in every loop.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel
from .hog import CLIP, ORIENTATIONS, SIGNED, TEXTURE, direction


@kernel
def pack_quads(gray, quads):  # type: ignore[no-untyped-def]
    """Pack each pixel with its right, lower and lower right neighbor into a word: ``quads`` (H, W) uint32 ← ``gray``.

    The border repeats. Interpolation then loads one word per sample instead of four pixels.
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
    """Sample a gray picture around a center bilinearly, on one grid per scale.

    ``quads`` (H, W) uint32 is the picture from :func:`pack_quads`. ``step_x`` and ``step_y`` (lanes,) float32 are the
    distances between neighboring samples in its pixels. ``out`` is (h, w, lanes) float32. Beyond the border the
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
def scale_gradients(samples, magnitude, orientation):  # type: ignore[no-untyped-def]
    """Write ``magnitude`` and ``orientation`` of the central differences of ``samples`` (h, w, lanes).

    The border repeats.
    """
    height, width, lanes = samples.shape
    for y in range(height):
        above, row, below = samples[max(y - 1, 0)], samples[y], samples[min(y + 1, height - 1)]
        for x in range(width):
            left, right, up, down = row[max(x - 1, 0)], row[min(x + 1, width - 1)], above[x], below[x]
            m, o = magnitude[y, x], orientation[y, x]
            for s in range(lanes):
                dx, dy = right[s] - left[s], down[s] - up[s]
                m[s] = np.sqrt(dx * dx + dy * dy)
                o[s] = direction(dx, dy)


@kernel
def scale_histogram(magnitude, orientation, histogram):  # type: ignore[no-untyped-def]
    """Add the bilinear votes of gradients (h, w, lanes) to cells of 4×4 pixels.

    ``histogram`` is (h/4 · w/4 + 1, 18, lanes) float32. Its last cell takes the votes outside the grid.
    """
    height, width, lanes = magnitude.shape
    cells_y, cells_x = height // 4, width // 4
    outside = cells_y * cells_x
    histogram[:] = 0
    fractions = (np.float32(0.625), np.float32(0.875), np.float32(0.125), np.float32(0.375))
    one = np.float32(1)
    for y in range(height):
        cy, lower = (y + 2) // 4, fractions[y % 4]  # votes go to cells cy - 1 and cy
        upper = one - lower
        for x in range(width):
            cx, after = (x + 2) // 4, fractions[x % 4]
            before = one - after
            a = histogram[(cy - 1) * cells_x + cx - 1 if cy > 0 and cx > 0 else outside]
            b = histogram[(cy - 1) * cells_x + cx if cy > 0 and cx < cells_x else outside]
            c = histogram[cy * cells_x + cx - 1 if cy < cells_y and cx > 0 else outside]
            d = histogram[cy * cells_x + cx if cy < cells_y and cx < cells_x else outside]
            m, directions = magnitude[y, x], orientation[y, x]
            for s in range(lanes):
                o, vote = directions[s], m[s]
                a[o, s] += upper * before * vote
                b[o, s] += upper * after * vote
                c[o, s] += lower * before * vote
                d[o, s] += lower * after * vote


@kernel
def scale_norms(histogram, epsilon, energy, norms):  # type: ignore[no-untyped-def]
    """Write 1 / √energy of each block of 2×2 cells: ``norms`` (cells_y + 1, cells_x + 1, lanes).

    ``energy`` (cells_y, cells_x, lanes) is scratch.
    """
    cells_y, cells_x, lanes = norms.shape[0] - 1, norms.shape[1] - 1, norms.shape[2]
    energy[:] = 0
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
def scale_features(histogram, norms, hann, texture, out):  # type: ignore[no-untyped-def]
    """Write the fHOG features of every scale times the Hann window over scales: ``out`` (cells, 31, lanes).

    ``hann`` (lanes,) is 0 for lanes that pad the scales. ``texture`` (4, lanes) is scratch.
    """
    cells_y, cells_x, lanes = norms.shape[0] - 1, norms.shape[1] - 1, norms.shape[2]
    half = np.float32(0.5)
    t0, t1, t2, t3 = texture[0], texture[1], texture[2], texture[3]
    for cy in range(cells_y):
        for cx in range(cells_x):
            cell, features = histogram[cy * cells_x + cx], out[cy * cells_x + cx]
            a, b = norms[cy, cx], norms[cy, cx + 1]
            c, d = norms[cy + 1, cx], norms[cy + 1, cx + 1]
            texture[:] = 0
            for o in range(SIGNED):
                h, feature = cell[o], features[o]
                for s in range(lanes):
                    va, vb = min(h[s] * a[s], CLIP), min(h[s] * b[s], CLIP)
                    vc, vd = min(h[s] * c[s], CLIP), min(h[s] * d[s], CLIP)
                    t0[s] += va
                    t1[s] += vb
                    t2[s] += vc
                    t3[s] += vd
                    feature[s] = half * hann[s] * (va + vb + vc + vd)
            for o in range(ORIENTATIONS):
                first, second, feature = cell[o], cell[o + ORIENTATIONS], features[SIGNED + o]
                for s in range(lanes):
                    v = first[s] + second[s]
                    total = min(v * a[s], CLIP) + min(v * b[s], CLIP) + min(v * c[s], CLIP) + min(v * d[s], CLIP)
                    feature[s] = half * hann[s] * total
            for k in range(4):
                t, feature = texture[k], features[SIGNED + ORIENTATIONS + k]
                for s in range(lanes):
                    feature[s] = TEXTURE * hann[s] * t[s]


@kernel
def scale_hog(  # type: ignore[no-untyped-def]
    gray, center_x, center_y, step_x, step_y, epsilon, hann,
    quads, samples, magnitude, orientation, histogram, energy, norms, texture, out,
):  # fmt: skip
    """Compute the features of every scale from a gray picture: all steps of this module in one call."""
    pack_quads(gray, quads)
    sample_scales(quads, center_x, center_y, step_x, step_y, samples)
    scale_gradients(samples, magnitude, orientation)
    scale_histogram(magnitude, orientation, histogram)
    scale_norms(histogram, epsilon, energy, norms)
    scale_features(histogram, norms, hann, texture, out)


@kernel
def respond_scales(spectra, numerator, label_f, energy, regularization, products, response_f):  # type: ignore[no-untyped-def]
    """Apply the filter (equation 3): ``response_f`` (half,) ← label / (energy + λ) · Σ conj(numerator) · spectrum.

    ``spectra`` and ``numerator`` are (cells, 31, half) complex64. ``products`` (31, half) complex64 is scratch.
    """
    products[:] = 0
    total = products.ravel()
    for cell in range(spectra.shape[0]):
        z, a = spectra[cell].ravel(), numerator[cell].ravel()
        for i in range(total.size):
            total[i] += np.conj(a[i]) * z[i]
    for k in range(response_f.size):
        response_f[k] = products[:, k].sum() * (label_f[k] / (energy[k] + regularization))


@kernel
def learn_scales(spectra, angles, rate, numerator, energy, rotations, squares):  # type: ignore[no-untyped-def]
    """Average ``spectra`` (cells, 31, half) into ``numerator`` and their energy into ``energy`` (half,).

    The phase of each frequency is shifted by its angle in ``angles`` (half,), which moves the spectra along the
    scales. ``rotations`` (31, half) complex64 and ``squares`` (31, half) float32 are scratch.
    """
    keep = np.float32(1) - rate
    for k in range(angles.size):
        rotations[:, k] = rate * np.complex64(complex(np.cos(angles[k]), np.sin(angles[k])))
    squares[:] = 0
    factor, total = rotations.ravel(), squares.ravel()
    for cell in range(spectra.shape[0]):
        z, a = spectra[cell].ravel(), numerator[cell].ravel()
        for i in range(total.size):
            total[i] += z[i].real * z[i].real + z[i].imag * z[i].imag
            a[i] = keep * a[i] + factor[i] * z[i]
    for k in range(energy.size):
        energy[k] = keep * energy[k] + rate * squares[:, k].sum()
