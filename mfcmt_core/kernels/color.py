"""Color histograms, their per-pixel look-up, and means over boxes by an integral image."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def bin_gray(patch, bins):  # type: ignore[no-untyped-def]
    """Write the bin, of 32, of each gray pixel: ``bins`` (H, W) uint16 ← ``patch`` (H, W) uint8."""
    height, width = bins.shape
    for y in range(height):
        for x in range(width):
            bins[y, x] = np.int32(patch[y, x]) >> 3


@kernel
def count_color(bin_, one, number, counts, shown):  # type: ignore[no-untyped-def]
    """Add ``one`` to a bin's count. Append the bin to ``shown`` if it is its first; return the length of that list."""
    count = counts[bin_]
    shown[number] = bin_
    counts[bin_] = count + one
    return number + np.uint64(count == 0)


@kernel
def shift(rectangle, dx, dy, height, width):  # type: ignore[no-untyped-def]
    """Return ``(top, left, bottom, right)`` shifted by (dx, dy) and clipped to the patch, and its area, at least 1."""
    top, bottom = min(max(rectangle[0] + dy, 0), height), min(max(rectangle[2] + dy, 0), height)
    left, right = min(max(rectangle[1] + dx, 0), width), min(max(rectangle[3] + dx, 0), width)
    return (top, left, bottom, right), max((bottom - top) * (right - left), 1)


@kernel
def learn_colors(  # type: ignore[no-untyped-def]
    bins, inner, outer, dx, dy, rate, decay_scale, unseen, shown, counts, histograms, lookup
):
    """Add the colors of a patch to both histograms (equation 11) and update the likelihoods of its bins.

    ``inner`` and ``outer`` are ``(top, left, bottom, right)``, shifted by (``dx``, ``dy``) pixels. Pixels inside
    ``inner`` are foreground, those outside ``outer`` are background, and those between are neither. Each region adds
    ``rate · decay_scale`` in all. ``histograms`` (bins, 2) float32 holds both histograms, ``lookup`` (bins,) float32
    the :func:`likelihood` of each bin. ``shown`` (pixels,) uint16 is scratch. ``counts`` (bins,) int64 holds one count
    in each half and is 0 before and after the call.
    """
    height, width = bins.shape
    inner, front = shift(inner, dx, dy, height, width)
    outer, covered = shift(outer, dx, dy, height, width)
    one_f = rate * decay_scale / np.float32(front)
    one_b = rate * decay_scale / np.float32(max(height * width - covered, 1))
    number = np.uint64(0)
    in_front, behind = np.int64(1), np.int64(1) << 32
    for y in range(height):
        row = bins[y]
        if inner[0] <= y < inner[2]:
            for x in range(inner[1], inner[3]):
                number = count_color(row[x], in_front, number, counts, shown)
        within = outer[0] <= y < outer[2]
        for x in range(outer[1] if within else width):
            number = count_color(row[x], behind, number, counts, shown)
        for x in range(outer[3] if within else width, width):
            number = count_color(row[x], behind, number, counts, shown)
    for i in range(number):
        bin_ = shown[i]
        histogram, count = histograms[bin_], counts[bin_]
        histogram[0] += one_f * np.float32(np.uint32(count))
        histogram[1] += one_b * np.float32(np.uint32(count >> 32))
        lookup[bin_] = likelihood(histogram[0], histogram[1], unseen)
        counts[bin_] = 0


@kernel
def likelihood(foreground, background, unseen):  # type: ignore[no-untyped-def]
    """Return F / (F + B) (equation 6), or ``unseen`` if neither region has shown the color."""
    total = foreground + background
    return foreground / total if total > 0 else unseen


@kernel
def tabulate(histograms, unseen, lookup):  # type: ignore[no-untyped-def]
    """Write the :func:`likelihood` of every bin of ``histograms`` (bins, 2) to ``lookup`` (bins,)."""
    for i in range(lookup.size):
        lookup[i] = likelihood(histograms[i, 0], histograms[i, 1], unseen)


@kernel
def integrate_likelihood(bins, lookup, integral):  # type: ignore[no-untyped-def]
    """Write the integral image of the pixels' likelihoods, ``integral`` (H + 1, W + 1) float32 (equation 7)."""
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
    """Write the mean over a box at each place, from four corners of the integral image (equation 7).

    ``rows`` and ``columns`` are the tops and lefts of the boxes; ``out`` (len(rows), len(columns)) float32.
    """
    scale = np.float32(1) / np.float32(box_height * box_width)
    for i in range(rows.size):
        top, bottom = integral[rows[i]], integral[rows[i] + box_height]
        for j in range(columns.size):
            left, right = columns[j], columns[j] + box_width
            out[i, j] = (bottom[right] - bottom[left] - top[right] + top[left]) * scale


@kernel
def subtract_bands(  # type: ignore[no-untyped-def]
    integral, rows, columns, box_height, box_width, band_height, band_width, weight, out
):
    """Subtract from each box's mean in ``out`` the mean over the band around the box, times ``weight``.

    Only the part of the band that lies in the patch counts.
    """
    height, width = integral.shape[0] - 1, integral.shape[1] - 1
    box_area = box_height * box_width
    for i in range(rows.size):
        top, bottom = max(rows[i] - band_height, 0), min(rows[i] + box_height + band_height, height)
        upper, lower = integral[top], integral[bottom]
        upper_box, lower_box = integral[rows[i]], integral[rows[i] + box_height]
        for j in range(columns.size):
            left, right = max(columns[j] - band_width, 0), min(columns[j] + box_width + band_width, width)
            area = (bottom - top) * (right - left) - box_area
            if area > 0:
                west, east = columns[j], columns[j] + box_width
                box = lower_box[east] - lower_box[west] - upper_box[east] + upper_box[west]
                both = lower[right] - lower[left] - upper[right] + upper[left]
                out[i, j] -= weight * (both - box) / np.float32(area)


@kernel
def likelihood_map(  # type: ignore[no-untyped-def]
    bins, lookup, integral, rows, columns, box_height, box_width, band_height, band_width, weight, out
):
    """Call :func:`integrate_likelihood`, :func:`box_means` and, unless ``weight`` is 0, :func:`subtract_bands`."""
    integrate_likelihood(bins, lookup, integral)
    box_means(integral, rows, columns, box_height, box_width, out)
    if weight != 0:
        subtract_bands(integral, rows, columns, box_height, box_width, band_height, band_width, weight, out)
