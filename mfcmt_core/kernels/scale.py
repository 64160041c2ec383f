"""Samples of the scale filter: one small patch a scale, all scales side by side in SIMD lanes.

Arrays end in the axis of scales, padded to ``lanes``, so that every inner loop runs over scales.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel
from .hog import _COS, _SIN, CLIP, TEXTURE


@kernel
def sample_scales(gray, center_x, center_y, step_x, step_y, out):  # type: ignore[no-untyped-def]
    """Bilinear samples of ``gray`` (H, W) uint8 around a centre, one grid of steps a scale.

    ``step_x``, ``step_y`` (lanes,) float32 are the distances of neighbouring samples in pixels of ``gray``;
    ``out`` (h, w, lanes) float32. Beyond the border the nearest pixel repeats.
    """
    height, width, lanes = out.shape
    max_x, max_y = np.float32(gray.shape[1] - 1), np.float32(gray.shape[0] - 1)
    limit_x, limit_y = gray.shape[1] - 1, gray.shape[0] - 1
    zero, half = np.float32(0), np.float32(0.5)
    x0 = np.empty((width, lanes), np.int32)
    fx = np.empty((width, lanes), np.float32)
    for j in range(width):
        offset = np.float32(j) + half - half * np.float32(width)
        for s in range(lanes):
            x = min(max(center_x + offset * step_x[s] - half, zero), max_x)
            whole = np.int32(x)
            x0[j, s] = whole
            fx[j, s] = x - np.float32(whole)
    for i in range(height):
        offset = np.float32(i) + half - half * np.float32(height)
        for s in range(lanes):
            y = min(max(center_y + offset * step_y[s] - half, zero), max_y)
            whole = np.int32(y)
            fy = y - np.float32(whole)
            top, bottom = gray[whole], gray[min(whole + 1, limit_y)]
            for j in range(width):
                left = x0[j, s]
                right = min(left + 1, limit_x)
                f = fx[j, s]
                a = np.float32(top[left]) + f * (np.float32(top[right]) - np.float32(top[left]))
                b = np.float32(bottom[left]) + f * (np.float32(bottom[right]) - np.float32(bottom[left]))
                out[i, j, s] = a + fy * (b - a)


@kernel
def scale_hog(samples, epsilon, histogram, norms, window, out):  # type: ignore[no-untyped-def]
    """fHOG of every scale's patch, times the window over scales.

    ``samples`` (h, w, lanes) with h, w multiples of 4; scratch ``histogram`` (h/4, w/4, 18, lanes)
    and ``norms`` (h/4 + 1, w/4 + 1, lanes); ``window`` (lanes,); ``out`` (h/4 · w/4 · 31, lanes).
    """
    height, width, lanes = samples.shape
    cells_y, cells_x = height // 4, width // 4
    histogram[:] = 0
    fractions = (np.float32(0.625), np.float32(0.875), np.float32(0.125), np.float32(0.375))
    one = np.float32(1)
    magnitude = np.empty(lanes, np.float32)
    direction = np.empty(lanes, np.int32)
    for y in range(height):
        above, below = samples[max(y - 1, 0)], samples[min(y + 1, height - 1)]
        row = samples[y]
        # weights of the two cell rows that this row votes into
        low_y = (y + 2) // 4 - 1
        w_low_y = fractions[y % 4]
        for x in range(width):
            left, right = row[max(x - 1, 0)], row[min(x + 1, width - 1)]
            up, down = above[x], below[x]
            for s in range(lanes):
                dx = right[s] - left[s]
                dy = down[s] - up[s]
                best = np.float32(0)
                bin_ = np.int32(0)
                for o in range(9):
                    dot = _COS[o] * dx + _SIN[o] * dy
                    if dot > best:
                        best = dot
                        bin_ = np.int32(o)
                    if -dot > best:
                        best = -dot
                        bin_ = np.int32(o + 9)
                magnitude[s] = np.sqrt(dx * dx + dy * dy)
                direction[s] = bin_
            low_x = (x + 2) // 4 - 1
            w_low_x = fractions[x % 4]
            for dy_ in range(2):
                cy = low_y + dy_
                if cy < 0 or cy >= cells_y:
                    continue
                wy = w_low_y if dy_ == 1 else one - w_low_y
                for dx_ in range(2):
                    cx = low_x + dx_
                    if cx < 0 or cx >= cells_x:
                        continue
                    weight = wy * (w_low_x if dx_ == 1 else one - w_low_x)
                    cell = histogram[cy, cx]
                    for s in range(lanes):
                        cell[direction[s], s] += weight * magnitude[s]
    energy = np.empty((cells_y, cells_x, lanes), np.float32)
    for cy in range(cells_y):
        for cx in range(cells_x):
            e = energy[cy, cx]
            e[:] = 0
            for o in range(9):
                for s in range(lanes):
                    v = histogram[cy, cx, o, s] + histogram[cy, cx, o + 9, s]
                    e[s] += v * v
    for by in range(cells_y + 1):
        y0, y1 = max(by - 1, 0), min(by, cells_y - 1)
        for bx in range(cells_x + 1):
            x0, x1 = max(bx - 1, 0), min(bx, cells_x - 1)
            for s in range(lanes):
                block = energy[y0, x0, s] + energy[y0, x1, s] + energy[y1, x0, s] + energy[y1, x1, s]
                norms[by, bx, s] = one / np.sqrt(block + epsilon)
    half = np.float32(0.5)
    for cy in range(cells_y):
        for cx in range(cells_x):
            base = (cy * cells_x + cx) * 31
            a, b = norms[cy, cx], norms[cy, cx + 1]
            c, d = norms[cy + 1, cx], norms[cy + 1, cx + 1]
            for k in range(4):
                out[base + 27 + k, :] = 0
            for o in range(18):
                h = histogram[cy, cx, o]
                for s in range(lanes):
                    va = min(h[s] * a[s], CLIP)
                    vb = min(h[s] * b[s], CLIP)
                    vc = min(h[s] * c[s], CLIP)
                    vd = min(h[s] * d[s], CLIP)
                    out[base + o, s] = half * (va + vb + vc + vd) * window[s]
                    out[base + 27, s] += TEXTURE * va * window[s]
                    out[base + 28, s] += TEXTURE * vb * window[s]
                    out[base + 29, s] += TEXTURE * vc * window[s]
                    out[base + 30, s] += TEXTURE * vd * window[s]
            for o in range(9):
                h1, h2 = histogram[cy, cx, o], histogram[cy, cx, o + 9]
                for s in range(lanes):
                    v = h1[s] + h2[s]
                    out[base + 18 + o, s] = (
                        half
                        * (min(v * a[s], CLIP) + min(v * b[s], CLIP) + min(v * c[s], CLIP) + min(v * d[s], CLIP))
                        * window[s]
                    )


@kernel
def respond_scales(spectra, numerator, denominator, regularization, response_f):  # type: ignore[no-untyped-def]
    """Equation 3 along scales: ``response_f`` (K,) ← Σ_d conj(numerator) · spectra / (denominator + λ)."""
    response_f[:] = 0
    features, frequencies = spectra.shape
    for d in range(features):
        for k in range(frequencies):
            response_f[k] += np.conj(numerator[d, k]) * spectra[d, k]
    for k in range(frequencies):
        response_f[k] /= denominator[k] + regularization


@kernel
def learn_scales(spectra, label_f, rate, numerator, denominator):  # type: ignore[no-untyped-def]
    """Running means of conj(label) · spectra and Σ_d |spectra|², moved by ``rate``."""
    features, frequencies = spectra.shape
    keep = np.float32(1) - rate
    for k in range(frequencies):
        denominator[k] *= keep
    for d in range(features):
        for k in range(frequencies):
            z = spectra[d, k]
            numerator[d, k] = keep * numerator[d, k] + rate * np.conj(label_f[k]) * z
            denominator[k] += rate * (z.real * z.real + z.imag * z.imag)
