"""Fourier transforms of stacks of small square real grids, as matrix products.

A grid has a few dozen cells per side, often a number that fast transforms handle badly. Products with matrices of
cosines and sines, after even and odd rows are separated, are faster at these sizes and allocate nothing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .kernels.fourier import assemble, fold_rows
from .workspace import scratch

Spectra = npt.NDArray[np.complex64]

ALIGNMENT = 8
"""The columns of a product are padded to a multiple of this."""


class Transform:
    """Transforms n × n cells to unnormalized half spectra, and half spectra back to the displacements within reach."""

    def __init__(self, cells: int, reach: tuple[int, int]) -> None:
        n, half = cells, cells // 2 + 1
        self.reach = reach
        index = np.arange(n)
        angles = 2 * np.pi / n * np.outer(index, index)
        rows = slice(1, (n + 1) // 2)  # where the sines are not 0
        self.even = np.cos(angles[:half, :half]).astype(np.float32)
        self.odd = np.sin(angles[rows, rows]).astype(np.float32)
        self.columns = np.zeros((n, -(-2 * half // ALIGNMENT) * ALIGNMENT), np.float32)
        self.columns[:, :half] = np.cos(angles[:, :half])
        self.columns[:, half : 2 * half] = np.sin(angles[:, :half])
        near = [np.arange(-r, r + 1) for r in reach]
        self.rows_back = np.exp(2j * np.pi / n * np.outer(near[1], index)).astype(np.complex64)
        twice = np.where((index[:half] == 0) | (2 * index[:half] == n), 1, 2) / n**2
        angles = 2 * np.pi / n * np.outer(index[:half], near[0])
        waves = np.stack([np.cos(angles), -np.sin(angles)], axis=1) * twice[:, None, None]
        self.columns_back = waves.reshape(2 * half, -1).astype(np.float32)

    def forward(self, grids: npt.NDArray[np.float32]) -> Spectra:
        """Return the half spectra (channels, n, n // 2 + 1) complex64 of ``grids`` (n, channels, n), rows first."""
        n, channels, _ = grids.shape
        half = len(self.even)
        even, odd = scratch("even_rows", (half, channels * n)), scratch("odd_rows", (n - half, channels * n))
        fold_rows(grids.reshape(n, -1), even, odd)
        sums = scratch("row_sums", (n, channels, n))
        np.matmul(self.even, even, out=sums[:half].reshape(half, -1))
        np.matmul(self.odd, odd, out=sums[half:].reshape(n - half, -1))
        products = scratch("products", (n, channels, self.columns.shape[1]))
        np.matmul(sums, self.columns, out=products)
        out = np.empty((channels, n, half), np.complex64)
        assemble(products, out)
        return out

    def backward(self, spectra: Spectra, out: npt.NDArray[np.float32]) -> None:
        """Transform half spectra (maps, n, n // 2 + 1) back to ``out`` (maps, 2·ry + 1, 2·rx + 1) float32.

        Zero displacement is in the middle of ``out``.
        """
        waves: npt.NDArray[np.float32] = (self.rows_back @ spectra).view(np.float32)
        np.matmul(waves, self.columns_back, out=out)
