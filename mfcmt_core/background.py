"""The background-aware template filter: a correlation filter that is zero outside the target's box.

A correlation filter over the whole search window learns the surroundings along with the target. This filter minimizes
the squared error over all shifts of the window among the filters that are zero outside the box, so that everything
outside becomes a negative example. The alternating direction method of multipliers (ADMM) finds it. Its errors differ
from those of the filter of equation 2, so the two together are better than either alone.

References
----------
H. Kiani Galoogahi, A. Fagg and S. Lucey, "Learning Background-Aware Correlation Filters for Visual Tracking",
ICCV 2017, arXiv:1703.04590.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .fourier import Spectra
from .geometry import SearchWindow
from .kernels.background import solve_background
from .kernels.template import energy
from .workspace import scratch

PENALTIES = (1.0, 10.0)
"""The penalty of ADMM in each iteration, as in that paper. Two iterations are enough.

Only the first training starts from zero. Later ones make one more iteration with the last penalty: the target has
changed by less than one iteration corrects."""


class BackgroundAwareFilter:
    """Trains the background-aware filters of one target.

    ``filters`` (channels, n, n // 2 + 1) complex64 are applied as in equation 3. ``unmasked``, of the same shape, are
    the filters before the mask, times the penalty and plus the multiplier: the state of ADMM.
    """

    def __init__(self, search_window: SearchWindow, channels: int, label_f: Spectra, regularization: float) -> None:
        n, half = search_window.cells, search_window.cells // 2 + 1
        self.regularization = regularization
        self.label = (np.conj(label_f) / n**2).astype(np.complex64)
        self.filters = np.zeros((channels, n, half), np.complex64)
        self.unmasked = np.zeros((channels, n, half), np.complex64)
        self.all_channels = np.array([0, channels], np.int64)
        frequencies, cells = np.arange(n), [_middle(n, side) for side in search_window.target]
        rows = np.exp(2j * np.pi / n * np.outer(cells[1], frequencies))
        self.rows_back, self.rows = rows.astype(np.complex64), rows.conj().T.astype(np.complex64)
        angles = 2 * np.pi / n * np.outer(frequencies[:half], cells[0])
        waves = np.stack([np.cos(angles), -np.sin(angles)], axis=1)
        twice = np.where((frequencies[:half] == 0) | (2 * frequencies[:half] == n), 1, 2) / n**2
        self.columns_back = (waves * twice[:, None, None]).reshape(2 * half, -1).astype(np.float32)
        self.columns = np.ascontiguousarray(waves.reshape(2 * half, -1).T, np.float32)

    def train(self, mean_spectra: Spectra, first: bool = False) -> None:
        """Train the filters on the mean of the target's spectra, (channels, n, n // 2 + 1) complex64."""
        power = scratch("background_power", mean_spectra.shape[1:])
        energy(mean_spectra, self.all_channels, power)
        power /= mean_spectra.shape[1] ** 2
        last_penalty = np.float32(PENALTIES[-1])
        if first:
            self.filters[:], self.unmasked[:] = 0, 0
            last_penalty = np.float32(0)
        for penalty in map(np.float32, PENALTIES if first else PENALTIES[-1:]):
            solve_background(mean_spectra, self.label, power, last_penalty, penalty, self.filters, self.unmasked)
            masked = self._masked(self.unmasked)
            np.multiply(masked, np.float32(1 / (penalty + self.regularization)), out=self.filters)
            last_penalty = penalty

    def _masked(self, spectra: Spectra) -> Spectra:
        """Return the spectra of the part of ``spectra`` that lies inside the target's box."""
        channels, n, half = spectra.shape
        by_rows = scratch("background_rows", (n, channels, half), np.complex64)
        by_rows[:] = spectra.transpose(1, 0, 2)  # one product for all channels
        waves: npt.NDArray[np.float32] = (self.rows_back @ by_rows.reshape(n, -1)).view(np.float32)
        inside = (waves.reshape(-1, 2 * half) @ self.columns_back) @ self.columns
        masked: Spectra = self.rows @ inside.view(np.complex64).reshape(self.rows.shape[1], -1)
        return masked.reshape(n, channels, half).transpose(1, 0, 2)


def _middle(cells: int, side: float) -> npt.NDArray[np.int64]:
    """Return the indices of the middle cells, of ``cells`` along a side, that the target takes."""
    count = max(1, round(side))
    return np.arange(count) + (cells - count) // 2
