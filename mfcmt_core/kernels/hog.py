"""fHOG: histograms of oriented gradients with 31 channels.

Arrays are planar, ``(rows, channels, columns)``, so that every inner loop runs along a row of cells.

References
----------
P. F. Felzenszwalb, R. B. Girshick, D. McAllester and D. Ramanan, "Object Detection with Discriminatively Trained
Part-Based Models", TPAMI 2010, doi:10.1109/TPAMI.2009.167.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel

ORIENTATIONS = 9
SIGNED = 2 * ORIENTATIONS
CHANNELS = SIGNED + ORIENTATIONS + 4
CLIP = np.float32(0.2)
TEXTURE = np.float32(0.2357)  # Felzenszwalb's weight of the four texture channels

_BORDERS = tuple(np.float32(np.tan(np.radians(a))) for a in (10, 30, 50, 70))  # of the directions 0°, 20°, … 80°


@kernel
def direction(dx, dy):  # type: ignore[no-untyped-def]
    """Return the nearest of 18 directions 20° apart, uint8; 0 for no gradient. float32 fills the SIMD lanes."""
    one, zero = np.float32(1), np.float32(0)
    x, y = abs(dx), abs(dy)
    quarter = (one if y > _BORDERS[0] * x else zero) + (one if y > _BORDERS[1] * x else zero)
    quarter += (one if y > _BORDERS[2] * x else zero) + (one if y > _BORDERS[3] * x else zero)
    turned = dy < 0  # by 180° into the upper half plane
    mirrored = (-dx if turned else dx) < 0
    half = np.float32(ORIENTATIONS) - quarter if mirrored else quarter
    full = half + np.float32(ORIENTATIONS) if turned else half
    return np.uint8(np.int32(zero if full == np.float32(SIGNED) else full))


@kernel
def gradients(gray, magnitude, orientation):  # type: ignore[no-untyped-def]
    """Write ``magnitude`` float32 and signed ``orientation`` uint8 of the central differences of ``gray`` (H, W) uint8.

    The orientation is the nearest of 18 directions; the border repeats.
    """
    height, width = gray.shape
    for y in range(height):
        above, row, below = gray[max(y - 1, 0)], gray[y], gray[min(y + 1, height - 1)]
        m, b = magnitude[y], orientation[y]
        for x in range(1, width - 1):
            dx = np.float32(row[x + 1]) - np.float32(row[x - 1])
            dy = np.float32(below[x]) - np.float32(above[x])
            m[x] = np.sqrt(dx * dx + dy * dy)
            b[x] = direction(dx, dy)
        m[0], b[0] = m[1], b[1]
        m[width - 1], b[width - 1] = m[width - 2], b[width - 2]


@kernel
def histogram_cells(magnitude, orientation, rows, histogram):  # type: ignore[no-untyped-def]
    """Add the bilinear votes of pixels to cells of 4×4: ``histogram`` (cells_y, 18, cells_x + 2) float32.

    Its first and last columns take the votes outside the grid. ``rows`` (4, 18, cells_x + 2) float32 is scratch: four
    rows of pixels vote into four buffers, so that consecutive additions go to different bins.
    """
    cells_y, _, columns = histogram.shape
    histogram[:] = 0
    fractions = (np.float32(0.625), np.float32(0.875), np.float32(0.125), np.float32(0.375))
    one = np.float32(1)
    down_0, down_1, down_2, down_3 = fractions
    up_0, up_1, up_2, up_3 = one - down_0, one - down_1, one - down_2, one - down_3
    r0, r1, r2, r3 = rows[0].ravel(), rows[1].ravel(), rows[2].ravel(), rows[3].ravel()
    # pixel p of a cell votes (1 - f) to the cell at `first` and f to the next; p = 0, 1 lean to the left
    for group in range(cells_y):
        rows[:] = 0
        y = 4 * group
        for cx in range(columns - 2):
            for p in range(4):
                right = fractions[p]
                left = one - right
                first = cx + (p >> 1)  # index into rows, whose column 0 is the cell left of the first
                x = 4 * cx + p
                for r in range(4):
                    bin_ = orientation[y + r, x]
                    vote = magnitude[y + r, x]
                    rows[r, bin_, first] += left * vote
                    rows[r, bin_, first + 1] += right * vote
        here = histogram[group].ravel()
        for i in range(here.size):
            here[i] += down_0 * r0[i] + down_1 * r1[i] + up_2 * r2[i] + up_3 * r3[i]
        if group > 0:
            above = histogram[group - 1].ravel()
            for i in range(above.size):
                above[i] += up_0 * r0[i] + up_1 * r1[i]
        if group + 1 < cells_y:
            below = histogram[group + 1].ravel()
            for i in range(below.size):
                below[i] += down_2 * r2[i] + down_3 * r3[i]


@kernel
def normalize_cells(histogram, hann, epsilon, norms, first, out):  # type: ignore[no-untyped-def]
    """Normalize, clip and window the cells of :func:`histogram_cells` into 31 planes of ``out``, from ``first`` on.

    ``out`` is (cells_y, channels, cells_x). ``hann`` (cells_y, cells_x) multiplies every channel. ``epsilon`` is added
    to each block's energy. ``norms`` (cells_y + 1, cells_x + 1) is scratch. Blocks beyond the border repeat the last
    cell.
    """
    cells_y, bins, cells_x = histogram.shape[0], histogram.shape[1], histogram.shape[2] - 2
    half = bins // 2
    previous = np.zeros(cells_x, np.float32)
    current = np.zeros(cells_x, np.float32)
    for cy in range(cells_y + 1):
        if cy < cells_y:
            current[:] = 0
            for o in range(half):
                for cx in range(cells_x):
                    e = histogram[cy, o, cx + 1] + histogram[cy, o + half, cx + 1]
                    current[cx] += e * e
        if cy == 0:
            previous[:] = current
        # block (cy, bx) covers cell rows cy-1, cy and columns bx-1, bx
        for bx in range(cells_x + 1):
            left, right = max(bx - 1, 0), min(bx, cells_x - 1)
            block = previous[left] + previous[right] + current[left] + current[right]
            norms[cy, bx] = np.float32(1) / np.sqrt(block + epsilon)
        previous[:] = current
    half_f = np.float32(0.5)
    texture = np.zeros((4, cells_x), np.float32)
    for cy in range(cells_y):
        up, down, win = norms[cy], norms[cy + 1], hann[cy]
        texture[:] = 0
        for o in range(bins):
            h = histogram[cy, o, 1:]
            target = out[cy, first + o]
            for cx in range(cells_x):
                a = min(h[cx] * up[cx], CLIP)
                b = min(h[cx] * up[cx + 1], CLIP)
                c = min(h[cx] * down[cx], CLIP)
                d = min(h[cx] * down[cx + 1], CLIP)
                target[cx] = half_f * (a + b + c + d) * win[cx]
                texture[0, cx] += a
                texture[1, cx] += b
                texture[2, cx] += c
                texture[3, cx] += d
        for o in range(half):
            h1, h2 = histogram[cy, o, 1:], histogram[cy, o + half, 1:]
            target = out[cy, first + bins + o]
            for cx in range(cells_x):
                s = h1[cx] + h2[cx]
                target[cx] = (
                    half_f
                    * (
                        min(s * up[cx], CLIP)
                        + min(s * up[cx + 1], CLIP)
                        + min(s * down[cx], CLIP)
                        + min(s * down[cx + 1], CLIP)
                    )
                    * win[cx]
                )
        for k in range(4):
            target = out[cy, first + bins + half + k]
            for cx in range(cells_x):
                target[cx] = TEXTURE * texture[k, cx] * win[cx]


@kernel
def hog_cells(gray, hann, epsilon, first, magnitude, orientation, rows, histogram, norms, out):  # type: ignore[no-untyped-def]
    """Compute fHOG from a gray patch: gradients, histogram and normalized planes in one call."""
    gradients(gray, magnitude, orientation)
    histogram_cells(magnitude, orientation, rows, histogram)
    normalize_cells(histogram, hann, epsilon, norms, first, out)
