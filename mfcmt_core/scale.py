"""The scale model: a one-dimensional correlation filter over the sizes of the target (DSST)."""

from __future__ import annotations

from math import log, sqrt

import cv2
import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .fourier import Spectra
from .geometry import CELL, Frame, Image, Rect
from .kernels.hog import CHANNELS, SIGNED
from .kernels.scale import learn_scales, respond_scales, scale_hog
from .workspace import scratch

Reals = npt.NDArray[np.float32]

LANES = 8
"""The number of scales is padded to a multiple of this: the float32 lanes of a SIMD register."""
MAX_SAMPLE_SIDE = 64
"""Largest side of a sample in pixels. With the area it bounds the cost for targets of any aspect ratio."""
MIN_SIDE = 5.0
"""Smallest side in pixels that a target may shrink to, unless it began smaller."""
OVERSAMPLING = 2.0
"""Largest number of gray pixels per pixel of a sample of scale 1: enough that the smallest scale does not alias."""


class ScaleModel:
    """Finds the target's size among ``num_scales`` steps around the last one.

    ``scale_samples`` samples cover the range: each is the target's box at one size, resized to at most
    ``scale_max_area`` pixels and described by fHOG. The filter is the ridge regression of equation 1 along the axis of
    scales, with a Gaussian label and a Hann window over it. ``numerator`` (cells, 31, n // 2 + 1) complex64 and
    ``energy`` (n // 2 + 1,) float32 are running means; the label is the same in every frame and not part of them. The
    response is a sum of waves, which can be evaluated at any scale between the samples (fDSST).

    Spectra are half spectra along the n samples, (cells, 31, n // 2 + 1) complex64. They count from the present scale,
    so that the spectrum of the symmetric label is real.

    ``frames_since_search`` counts the learned frames since the last search of the scale.

    References
    ----------
    M. Danelljan, G. Häger, F. S. Khan and M. Felsberg, "Accurate Scale Estimation for Robust Visual Tracking" (DSST),
    BMVC 2014, doi:10.5244/C.28.65; "Discriminative Scale Space Tracking" (fDSST), TPAMI 2017, arXiv:1609.06141.
    """

    def __init__(self, config: MFCMTConfig, base_size: tuple[float, float]) -> None:
        n = self.count = min(config.scale_samples, config.num_scales)
        self.interval = config.scale_interval
        self.frames_since_search = 0
        self.rate = np.float32(config.scale_learning_rate)
        self.regularization = np.float32(config.scale_regularization)
        self.epsilon = np.float32(config.hog_epsilon)
        self.base_size = base_size
        shrink = sqrt(config.scale_max_area / (base_size[0] * base_size[1]))
        self.width, self.height = (_sample_side(side * shrink) for side in base_size)
        fine = np.arange(-(config.num_scales // 2), config.num_scales // 2 + 1)
        self.factors = (config.scale_step ** fine.astype(float)).astype(np.float32)
        spacing = config.num_scales / n
        sample_step = config.scale_step**spacing
        steps = np.arange(-(n // 2), n // 2 + 1)
        self.largest = sample_step ** (n // 2)
        padding = (0, -n % LANES)
        self.lane_factors = np.pad(sample_step**steps, padding, constant_values=1).astype(np.float32)
        self.hann = np.pad(np.hanning(n + 2)[1:-1], padding).astype(np.float32)
        # n is small and odd: a matrix product is faster than any fast transform
        frequencies = 2 * np.pi / n * np.arange(n // 2 + 1)
        waves = np.exp(-1j * np.outer(np.pad(steps, padding), frequencies)).astype(np.complex64)
        self.transform = waves.view(np.float32)
        twice = np.where(frequencies == 0, 1, 2) / n
        back = np.exp(-1j * np.outer(fine / spacing, frequencies)) * twice
        self.inverse = back.astype(np.complex64).view(np.float32)
        self.angle_of_growth = (frequencies / log(sample_step)).astype(np.float32)
        label = np.exp(-0.5 * (steps * spacing / (sqrt(config.num_scales) * config.scale_sigma_factor)) ** 2)
        self.label_f = (label @ np.cos(np.outer(steps, frequencies))).astype(np.float32)
        cells = (self.width // CELL) * (self.height // CELL)
        self.numerator: Spectra = np.zeros((cells, CHANNELS, len(frequencies)), np.complex64)
        self.energy = np.zeros(len(frequencies), np.float32)

    def advance(self, busy: bool) -> bool:
        """Count one more learned frame, and return True if the scale is to be searched in it.

        That is every ``interval``-th frame. A ``busy`` frame, which has probed other places, leaves the search to the
        next one until twice the interval has passed.
        """
        self.frames_since_search += 1
        if self.frames_since_search < self.interval * (2 if busy else 1):
            return False
        self.frames_since_search = 0
        return True

    def estimate(self, spectra: Spectra) -> float:
        """Return the factor from the size that ``spectra`` were taken at to the target's size."""
        products = scratch("scale_products", spectra.shape[1:], np.complex64)
        response_f = scratch("scale_response", self.energy.shape, np.complex64)
        respond_scales(spectra, self.numerator, self.label_f, self.energy, self.regularization, products, response_f)
        response = self.inverse @ response_f.view(np.float32)
        best, same = response.argmax(), len(self.factors) // 2
        return float(self.factors[best if response[best] > response[same] else same])

    def learn(self, spectra: Spectra, growth: float = 1.0, first: bool = False) -> None:
        """Learn ``spectra`` of a target that is ``growth`` times as large as the size they were taken at."""
        rate = np.float32(1) if first else self.rate
        angles = self.angle_of_growth * np.float32(log(growth))
        rotations = scratch("scale_products", spectra.shape[1:], np.complex64)
        learn_scales(
            spectra, angles, rate, self.numerator, self.energy, rotations, scratch("scale_squares", rotations.shape)
        )

    def load_real_waves(self, waves: Reals, sums: Reals, energy: Reals) -> None:
        """Load a filter from real arrays, as version 3 of a snapshot holds it.

        ``waves`` (features, 2 · lanes) are the cosine sums of the frequencies from 1 on, then the sine sums, each
        padded to ``lanes``. ``sums`` (features,) is frequency 0. ``energy`` (lanes + 1,) has frequency 0 last.
        """
        reach, lanes = self.count // 2, len(energy) - 1
        numerator = self.numerator.reshape(len(sums), -1)
        numerator[:, 0], self.energy[0] = sums, energy[-1]
        numerator[:, 1:] = waves[:, :reach] - 1j * waves[:, lanes : lanes + reach]
        self.energy[1:] = energy[:reach]

    def clamp(self, scale: float, frame_size: tuple[int, int]) -> float:
        """Return ``scale`` clipped so that the target has a few pixels at least and fits into the frame."""
        w, h = self.base_size
        lowest = min(1.0, MIN_SIDE / min(w, h))
        highest = max(1.0, min(frame_size[0] / w, frame_size[1] / h))
        return min(max(scale, lowest), highest)

    def spectra(self, frame: Frame, readable: Rect, center: tuple[float, float], scale: float) -> Spectra:
        """Return the spectra of the target at ``center`` around ``scale``. The array is scratch until the next call."""
        w, h = self.base_size[0] * scale, self.base_size[1] * scale
        gray, (cx, cy), (fx, fy) = _sample_gray(
            frame, readable, center, (w, h), self.largest, (self.width, self.height)
        )
        ny, nx, lanes = self.height // CELL, self.width // CELL, len(self.lane_factors)
        samples = (self.height, self.width, lanes)
        features = scratch("scale_features", (ny * nx, CHANNELS, lanes))
        scale_hog(
            gray,
            np.float32(cx),
            np.float32(cy),
            self.lane_factors * np.float32(w / self.width / fx),
            self.lane_factors * np.float32(h / self.height / fy),
            self.epsilon,
            self.hann,
            scratch("quads", gray.shape, np.uint32),
            scratch("scale_samples", samples),
            scratch("scale_magnitude", samples),
            scratch("scale_orientation", samples, np.uint8),
            scratch("scale_histogram", (ny * nx + 1, SIGNED, lanes)),
            scratch("scale_energy", (ny, nx, lanes)),
            scratch("scale_norms", (ny + 1, nx + 1, lanes)),
            scratch("scale_texture", (4, lanes)),
            features,
        )
        spectra = scratch("scale_spectra", self.numerator.shape, np.complex64)
        # row by row: such small products do not start BLAS threads, which cost more than they save
        rows = (ny, nx * CHANNELS, -1)
        np.matmul(features.reshape(rows), self.transform, out=spectra.view(np.float32).reshape(rows))
        return spectra


def _sample_side(side: float) -> int:
    """Return ``side`` rounded to whole cells, at least two, so that a thin target still gives a sample with texture."""
    return min(max(round(side / CELL) * CELL, 2 * CELL), MAX_SAMPLE_SIDE)


def _sample_gray(
    frame: Frame,
    readable: Rect,
    center: tuple[float, float],
    size: tuple[float, float],
    largest: float,
    sample_size: tuple[int, int],
) -> tuple[Image, tuple[float, float], tuple[float, float]]:
    """Sample the gray pixels around the target that the largest scale covers, at the resolution that is needed.

    Returns the pixels, the target's center (x, y) in them, and the frame's pixels (x, y) per pixel.
    """
    out, cut = [], []
    for length, samples in zip(size, sample_size, strict=True):
        whole = max(2, round(length * largest) + 2)
        cut.append(whole)
        out.append(min(whole, round(OVERSAMPLING * samples * largest) + 2))
    x, y = round(center[0] - cut[0] / 2), round(center[1] - cut[1] / 2)
    pixels = frame.sample((x, y, cut[0], cut[1]), readable, (out[0], out[1]))
    gray = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    factor = (cut[0] / out[0], cut[1] / out[1])
    return gray, ((center[0] - x) / factor[0], (center[1] - y) / factor[1]), factor  # type: ignore[return-value]
