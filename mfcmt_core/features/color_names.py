"""Color names: how well each of eleven names fits a color, as a table over the RGB cube.

The table is computed from published fuzzy sets. In each of six bands of lightness, the membership of a chromatic name
is the product of two sigmoids across its hue sector and one around an elliptical achromatic center. Black, gray and
white share the rest by lightness. The numbers below are the published fit (CIELAB, angles in radians).

References
----------
R. Benavente, M. Vanrell and R. Baldrich, "Parametric fuzzy sets for automatic color naming", JOSA A 25(10), 2008,
doi:10.1364/JOSAA.25.002582.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import BadConfig

NAMES = ("red", "orange", "brown", "yellow", "green", "blue", "purple", "pink", "black", "grey", "white")
LEVELS = 32  # of each of R, G, B
MAX_VALUE = 1e6  # of a table from a file, so that spectra stay well inside float32

_BANDS = (0.0, 31.0, 42.0, 51.0, 66.0, 76.0, 101.0)  # of L*
# one row per band: center a*, b*; slope, semi-axes and angle of the achromatic ellipse
_CENTERS = np.array(
    [
        [0.42420, 0.24936, 9.84406, 5.88940, 7.47432, 0.04051],
        [0.22956, 0.66319, 6.03260, 6.45705, 7.87255, 0.30702],
        [-0.11734, 0.51801, 6.81218, 5.38109, 6.98238, 0.34177],
        [-0.44317, 1.07592, 7.31858, 6.06366, 7.50205, 0.42845],
        [-0.56546, 1.16328, 100.0, 5.36821, 6.90048, 0.43202],
        [-1.25643, 1.81438, 100.0, 6.03990, 7.39319, -0.02082],
    ]
)
# per band and name: angles α_x, α_y of the sector's sides and slopes β_x, β_y; names that a band lacks are left out
_SECTORS: tuple[dict[str, tuple[float, float, float, float]], ...] = (
    {
        "red": (-0.03908, -0.98697, 0.90099, 1.72499),
        "brown": (0.58383, 0.25404, 1.72499, 0.84403),
        "green": (1.82484, 2.34899, 0.84403, 1.95218),
        "blue": (3.91979, -2.56831, 1.95218, 1.01425),
        "purple": (-0.99751, -1.60988, 1.01425, 0.90099),
    },
    {
        "red": (0.03853, -0.85197, 0.52436, 5.0),
        "brown": (0.71883, 0.11993, 5.0, 0.69240),
        "green": (1.69073, 2.10250, 0.69240, 0.95811),
        "blue": (3.67330, -2.59153, 0.95811, 0.91661),
        "purple": (-1.02074, -1.84516, 0.91661, 1.10032),
        "pink": (-0.27436, -1.53226, 1.10032, 0.52436),
    },
    {
        "red": (0.23688, -0.79492, 0.99938, 0.56528),
        "orange": (0.77587, -0.50201, 0.56528, 0.51723),
        "brown": (1.06878, 0.11614, 0.51723, 0.84479),
        "green": (1.68694, 1.90898, 0.84479, 0.59976),
        "blue": (3.47977, -2.58725, 0.59976, 0.80082),
        "purple": (-1.01645, -1.96583, 0.80082, 0.62367),
        "pink": (-0.39503, -1.33392, 0.62367, 0.99938),
    },
    {
        "red": (0.46288, -0.99504, 0.93911, 0.75484),
        "orange": (0.57576, -0.17249, 0.75484, 0.47835),
        "yellow": (1.39830, 0.09902, 0.47835, 0.72874),
        "green": (1.66981, 1.89048, 0.72874, 0.64383),
        "blue": (3.46128, -2.59661, 0.64383, 0.75521),
        "purple": (-1.02581, -2.16285, 0.75521, 5.0),
        "pink": (-0.59206, -1.10792, 5.0, 0.93911),
    },
    {
        "orange": (0.44944, -0.27655, 1.99512, 0.83991),
        "yellow": (1.29424, 0.21417, 0.83991, 0.85600),
        "green": (1.78496, 1.72031, 0.85600, 0.73664),
        "blue": (3.29111, -2.63249, 0.73664, 0.47481),
        "purple": (-1.06169, -2.13886, 0.47481, 1.73558),
        "pink": (-0.56807, -1.12136, 1.73558, 1.99512),
    },
    {
        "orange": (0.44932, -0.30642, 1.02801, 0.79098),
        "yellow": (1.26437, 0.28346, 0.79098, 0.95741),
        "green": (1.85426, 1.74613, 0.95741, 0.90001),
        "blue": (3.31692, -2.60809, 0.90001, 0.59898),
        "purple": (-1.03729, -2.13569, 0.59898, 1.93131),
        "pink": (-0.56490, -1.12148, 1.93131, 1.02801),
    },
)
_BLACK_GREY = (28.2825, 0.71423)  # lightness and slope of the change from one to the other
_GREY_WHITE = (79.6493, 0.30674)


def _sigmoid(x: npt.NDArray[np.float64], slope: float) -> npt.NDArray[np.float64]:
    return 1 / (1 + np.exp(np.clip(-slope * x, -500, 500)))


def _cielab(rgb: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return CIELAB under D65 of sRGB in [0, 1], both (n, 3)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array(
        [[0.412424, 0.357579, 0.180464], [0.212656, 0.715158, 0.0721856], [0.0193324, 0.119193, 0.950444]]
    )
    t = linear @ to_xyz.T / (0.9505, 1.0, 1.0891)
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def memberships(rgb: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return how well each of :data:`NAMES` fits sRGB colors (n, 3) in 0–255: (n, 11), each row with sum 1."""
    lab = _cielab(np.asarray(rgb, np.float64).reshape(-1, 3) / 255)
    out = np.zeros((len(lab), len(NAMES)))
    band = np.clip(np.searchsorted(_BANDS, lab[:, 0], side="right") - 1, 0, len(_SECTORS) - 1)
    for level, sectors in enumerate(_SECTORS):
        inside = band == level
        tx, ty, slope, ex, ey, angle = _CENTERS[level]
        a, b = lab[inside, 1] - tx, lab[inside, 2] - ty
        along, across = a * np.cos(angle) + b * np.sin(angle), -a * np.sin(angle) + b * np.cos(angle)
        chromatic = _sigmoid((along / ex) ** 2 + (across / ey) ** 2 - 1, slope)
        for name, (ax, ay, bx, by) in sectors.items():
            sides = _sigmoid(a * np.cos(ay) + b * np.sin(ay), by) * _sigmoid(-a * np.sin(ax) + b * np.cos(ax), bx)
            out[inside, NAMES.index(name)] = chromatic * sides
    rest = np.maximum(1 - out.sum(1), 0)
    dark = _sigmoid(lab[:, 0] - _BLACK_GREY[0], -_BLACK_GREY[1])
    light = _sigmoid(lab[:, 0] - _GREY_WHITE[0], _GREY_WHITE[1])
    out[:, 8], out[:, 9], out[:, 10] = rest * dark, rest * (1 - dark) * (1 - light), rest * light
    out /= np.maximum(out.sum(1, keepdims=True), 1e-12)
    return out


def _bin_centers() -> npt.NDArray[np.float64]:
    """Return the middle color of each bin, (32768, 3) RGB. Red varies fastest, as in all published tables."""
    levels = np.arange(LEVELS) * (256 / LEVELS) + 128 / LEVELS
    b, g, r = np.meshgrid(levels, levels, levels, indexing="ij")
    return np.stack([r, g, b], axis=-1).reshape(-1, 3)


def _read(file: str) -> npt.NDArray[np.float64]:
    """Return the table in a ``.npy`` file as it is. Raises BadConfig."""
    if not Path(file).is_file():
        raise BadConfig(f"color_name_table {file!r} is not a file")
    try:
        stored = np.lib.format.open_memmap(file, mode="r")  # reads only the header of a file that does not fit
    except (OSError, ValueError) as error:
        raise BadConfig(f"color_name_table {file!r} cannot be read: {error}") from error
    if stored.ndim != 2 or len(stored) != LEVELS**3 or not 1 <= stored.shape[1] <= 16 or stored.dtype.kind not in "fiu":
        raise BadConfig(f"color_name_table {file!r} is {stored.dtype} of shape {stored.shape}, not (32768, 1..16)")
    values = np.array(stored, np.float64)
    if not (np.abs(values) <= MAX_VALUE).all():
        raise BadConfig(f"color_name_table {file!r} has values that are not finite or beyond {MAX_VALUE}")
    return values


@lru_cache(maxsize=4)
def table(file: str | None = None) -> npt.NDArray[np.float32]:
    """Return the color-name features of the 32×32×32 RGB bins.

    Parameters
    ----------
    file : str, optional
        A ``.npy`` file of shape (32768, L) with L ≤ 16 to use instead of the computed table.

    Returns
    -------
    ndarray of float32, shape (32768, L)
        The features of bin ``r//8 + 32·(g//8) + 1024·(b//8)``, read-only; each column has mean zero. L is 10 without
        ``file``: the eleven memberships add up to one, so ten orthonormal combinations hold all information.

    Raises
    ------
    BadConfig
        If the file cannot be used.
    """
    if file is None:
        values = memberships(_bin_centers())
        values -= values.mean(0)
        # the rows have sum 0; Helmert's matrix is an orthonormal basis of that hyperplane
        n = len(NAMES)
        helmert = np.tril(np.ones((n - 1, n)), 0) - np.diag(np.arange(1, n), 1)[: n - 1]
        values = values @ (helmert / np.linalg.norm(helmert, axis=1, keepdims=True)).T
    else:
        values = _read(file)
        values -= values.mean(0)
    result = np.ascontiguousarray(values, dtype=np.float32)
    result.flags.writeable = False
    return result
