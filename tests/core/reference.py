"""The numpy twin of every kernel: written for clarity, in float64, from the definitions and not from the loops."""

from __future__ import annotations

import numpy as np

CELL = 4
CLIP = 0.2
TEXTURE = 0.2357
DIRECTIONS = np.arange(18) * np.pi / 9


# --- cells ---


def gray_cells(gray, window):
    cells_y, cells_x = window.shape
    means = gray.reshape(cells_y, CELL, cells_x, CELL).astype(float).mean((1, 3))
    return (means / 255 - 0.5) * window


def color_name_cells(patch, table, window):
    cells_y, cells_x = window.shape
    means = patch.reshape(cells_y, CELL, cells_x, CELL, 3).astype(float).mean((1, 3))
    return np.moveaxis(table[bin_pixels(np.floor(means + 0.5))], -1, 0) * window


# --- fHOG ---


def projections(dx, dy):
    """Return the projection of each gradient on each of the 18 directions, (18, ...)."""
    return np.multiply.outer(np.cos(DIRECTIONS), dx) + np.multiply.outer(np.sin(DIRECTIONS), dy)


def differences(pixels):
    """Return the central differences along x and y; the border repeats."""
    padded = np.pad(pixels.astype(float), 1, mode="edge")
    return padded[1:-1, 2:] - padded[1:-1, :-2], padded[2:, 1:-1] - padded[:-2, 1:-1]


def gradients(gray):
    """Return the magnitude and the projections (18, H, W); the outermost columns repeat their neighbors."""
    dx, dy = differences(gray)
    for d in (dx, dy):
        d[:, 0], d[:, -1] = d[:, 1], d[:, -2]
    return np.hypot(dx, dy), projections(dx, dy)


def histogram_cells(magnitude, orientation):
    """Share each pixel's magnitude among the four cells whose centers surround it: (cells_y, 18, cells_x)."""
    height, width = magnitude.shape
    cells_y, cells_x = height // CELL, width // CELL
    out = np.zeros((cells_y + 2, 18, cells_x + 2))  # a ring of cells around catches what leaves the grid
    y, x = np.mgrid[:height, :width]
    v, u = (y + 0.5) / CELL - 0.5, (x + 0.5) / CELL - 0.5
    low_v, low_u = np.floor(v).astype(int), np.floor(u).astype(int)
    for dv in (0, 1):
        for du in (0, 1):
            weight = (1 - np.abs(v - low_v - dv)) * (1 - np.abs(u - low_u - du))
            np.add.at(out, (low_v + dv + 1, orientation, low_u + du + 1), weight * magnitude)
    return out[1:-1, :, 1:-1]


def normalize_cells(histogram, window, epsilon):
    """Return Felzenszwalb's 18 signed, 9 unsigned and 4 texture channels, (31, cells_y, cells_x)."""
    signed = np.moveaxis(histogram.astype(float), 1, 0)
    unsigned = signed[:9] + signed[9:]
    energy = np.pad((unsigned**2).sum(0), 1, mode="edge")
    blocks = energy[:-1, :-1] + energy[:-1, 1:] + energy[1:, :-1] + energy[1:, 1:]
    factors = 1 / np.sqrt(blocks + epsilon)
    corners = [factors[:-1, :-1], factors[:-1, 1:], factors[1:, :-1], factors[1:, 1:]]
    clipped = [np.minimum(signed * f, CLIP) for f in corners]
    return window * np.concatenate(
        [
            0.5 * sum(clipped),
            0.5 * sum(np.minimum(unsigned * f, CLIP) for f in corners),
            TEXTURE * np.stack([c.sum(0) for c in clipped]),
        ]
    )


# --- colour ---


def bin_pixels(patch):
    b, g, r = np.moveaxis(patch.astype(int) // 8, -1, 0)
    return r + 32 * g + 1024 * b


def bin_gray(patch):
    return patch.astype(int) // 8


def count_colors(bins, inner, outer, size):
    top, left, bottom, right = inner
    foreground = np.bincount(bins[top:bottom, left:right].ravel(), minlength=size).astype(float)
    outside = np.ones(bins.shape, bool)
    top, left, bottom, right = outer
    outside[top:bottom, left:right] = False
    background = np.bincount(bins[outside], minlength=size).astype(float)
    return foreground, background


def tabulate(histograms, unseen):
    f, b = histograms.astype(float).T
    return np.divide(f, f + b, out=np.full(f.shape, float(unseen)), where=f + b > 0)


def integral(bins, lookup):
    return np.pad(lookup[bins].astype(float), ((1, 0), (1, 0))).cumsum(0).cumsum(1)


def shift(rectangle, dx, dy, height, width):
    """Return ``(top, left, bottom, right)`` shifted and clipped to the patch."""
    return tuple(int(v) for v in np.clip(np.add(rectangle, (dy, dx, dy, dx)), 0, (height, width, height, width)))


def box_means(likelihood, rows, columns, height, width):
    return np.array([[likelihood[r : r + height, c : c + width].mean() for c in columns] for r in rows])


def box_contrasts(likelihood, rows, columns, box, band, weight):
    """Return the mean in each box minus ``weight`` times the mean of the band around it."""
    height, width = likelihood.shape
    out = np.empty((len(rows), len(columns)))
    for i, r in enumerate(rows):
        for j, c in enumerate(columns):
            inside, around = np.zeros((2, height, width), bool)
            inside[r : r + box[0], c : c + box[1]] = True
            around[max(r - band[0], 0) : r + box[0] + band[0], max(c - band[1], 0) : c + box[1] + band[1]] = True
            out[i, j] = likelihood[inside].mean() - weight * likelihood[around & ~inside].mean()
    return out


# --- correlation filters ---


def respond_filters(filters, spectra, blocks):
    return np.stack([(np.conj(filters[a:b]) * spectra[a:b]).sum(0) for a, b in blocks])


def energy(spectra, block):
    return (np.abs(spectra[block[0] : block[1]]) ** 2).sum(0)


def phase_shift(spectra, dx, dy):
    """Apply the shift theorem with all frequencies written out."""
    n = spectra.shape[1]
    rows, columns = np.fft.fftfreq(n)[:, None], np.arange(spectra.shape[2]) / n
    return spectra * np.exp(2j * np.pi * (columns * dx + rows * dy))


def learn_filters(spectra, label_f, blocks, regularization, rate, filters):
    new = np.empty_like(filters)
    for a, b in blocks:
        new[a:b] = np.conj(label_f) * spectra[a:b] / (energy(spectra, (a, b)) + regularization)
    return (1 - rate) * filters + rate * new


def divide_label(label_f, denominator, regularization):
    return label_f / (denominator + regularization)


def learn_spectra(spectra, blocks, rate, mean, denominator):
    energies = np.stack([energy(spectra, block) for block in blocks])
    return (1 - rate) * mean + rate * spectra, (1 - rate) * denominator + rate * energies


def solve_background(mean, label, power, before, penalty, filters, unmasked):
    cells = mean.shape[1] ** 2
    rest = mean * label + (penalty + before) * filters - unmasked
    projection = (np.conj(mean) * rest).sum(0) / cells
    return mean * label + penalty * filters - mean * projection / (penalty + power)


# --- Fourier ---


def fold_rows(grids):
    """Return sums and differences of opposite rows; a row that is its own opposite counts once."""
    n = len(grids)
    opposite = grids[-np.arange(n) % n]
    even = np.where((2 * np.arange(n) % n == 0)[:, None], grids, grids + opposite)
    return even[: n // 2 + 1], (grids - opposite)[1 : (n + 1) // 2]


# --- fusion ---


def fuse_maps(responses, weights, floor, power):
    maps = responses.astype(float)
    if floor < 2:
        low = maps.min((1, 2), keepdims=True) if floor == 1 else 0.0
        maps = np.maximum(maps - low, 0) ** power
        total = maps.sum((1, 2), keepdims=True)
        maps = np.where(total > 1e-20, maps / np.where(total > 1e-20, total, 1), 1 / maps[0].size)
    return maps, np.average(maps, axis=0, weights=weights)


def find_peak(fused, leave_out):
    i, j = np.unravel_index(fused.argmax(), fused.shape)

    def vertex(line, k):
        if not 0 < k < len(line) - 1:
            return float(k)
        a = np.polyfit([-1, 0, 1], line[k - 1 : k + 2].astype(float), 2)[0]
        slope = (float(line[k + 1]) - float(line[k - 1])) / 2
        return k + (np.clip(-slope / (2 * a), -0.5, 0.5) if a < 0 else 0.0)

    rows, columns = np.indices(fused.shape)
    sidelobe = fused[(abs(rows - i) > leave_out) | (abs(columns - j) > leave_out)].astype(float)
    height = float(fused[i, j])
    spread = sidelobe.std() if sidelobe.size else 0.0
    psr = (height - sidelobe.mean()) / spread if spread > 1e-6 * height else 0.0
    return vertex(fused[:, j], i), vertex(fused[i], j), height, psr


# --- scale ---


def sample_scales(gray, center_x, center_y, step_x, step_y, shape):
    """Interpolate bilinearly on a grid of points around the center, one grid per scale: (h, w, scales)."""
    height, width = shape
    pixels = gray.astype(float)
    out = np.empty((height, width, len(step_x)))
    for s in range(len(step_x)):
        x = center_x + (np.arange(width) + 0.5 - width / 2) * step_x[s] - 0.5
        y = center_y + (np.arange(height) + 0.5 - height / 2) * step_y[s] - 0.5
        x, y = np.clip(x, 0, gray.shape[1] - 1), np.clip(y, 0, gray.shape[0] - 1)
        columns = np.array([np.interp(x, np.arange(gray.shape[1]), row) for row in pixels])
        out[..., s] = np.array([np.interp(y, np.arange(gray.shape[0]), column) for column in columns.T]).T
    return out


def pack_quads(gray):
    """Return each pixel with its right, lower and lower right neighbor, (H, W, 4) uint8; the border repeats."""
    padded = np.pad(gray, ((0, 1), (0, 1)), mode="edge")
    return np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]], axis=-1)


def scale_gradients(samples):
    """Return the magnitude (h, w, scales) and projections (18, h, w, scales) of each scale's sample."""
    d = np.stack([differences(samples[..., s]) for s in range(samples.shape[-1])], axis=-1)
    return np.hypot(*d), projections(*d)


def scale_histogram(magnitude, orientation):
    """Return the votes of each scale's gradients, (cells_y, 18, cells_x, scales)."""
    scales = range(magnitude.shape[-1])
    return np.stack([histogram_cells(magnitude[..., s], orientation[..., s]) for s in scales], axis=-1)


def scale_features(histogram, epsilon, window):
    """Return the fHOG of each scale's sample times its weight, (cells_y · cells_x, 31, scales)."""
    features = np.stack([normalize_cells(histogram[..., s], w, epsilon) for s, w in enumerate(window)], axis=-1)
    return np.moveaxis(features, 0, 2).reshape(-1, *features.shape[::3])


def respond_scales(spectra, mean, label_f, energy, regularization):
    return (np.conj(mean) * spectra).sum((0, 1)) * label_f / (energy + regularization)


def learn_scales(spectra, phase, rate, mean, energy):
    energies = (np.abs(spectra) ** 2).sum((0, 1))
    return (1 - rate) * mean + rate * phase * spectra, (1 - rate) * energy + rate * energies
