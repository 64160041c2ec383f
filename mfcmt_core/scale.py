"""The scale filter of DSST (Danelljan et al., BMVC 2014): a one-dimensional correlation filter over sizes."""

from __future__ import annotations

from math import sqrt

import cv2
import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .geometry import CELL, Frame, Image, Rect
from .kernels.hog import CHANNELS, SIGNED
from .kernels.scale import learn_scales, respond_scales, sample_scales, scale_hog
from .workspace import scratch

Spectra = npt.NDArray[np.complex64]

LANES = 8
"""Scales are padded to a multiple of this many SIMD lanes."""
MAX_SAMPLE_SIDE = 64
"""Pixels: together with the area this bounds the cost for targets of any aspect."""
MIN_SIDE = 5.0
"""Pixels; a target is not followed below this size, unless it began smaller."""
OVERSAMPLING = 2.0
"""Pixels of the grey cut a sample of scale 1, at most: enough that the smallest scale does not alias."""


class ScaleModel:
    """Finds the target's size among ``num_scales`` steps around the last one.

    One sample a scale: the target's box at that size, resized to at most ``scale_max_area`` pixels, as
    fHOG; the filter is the ridge regression of equation 1 along the axis of scales, with a Gaussian
    label and a Hann window over it; numerator and denominator are running means.
    """

    def __init__(self, config: MFCMTConfig, base_size: tuple[float, float]) -> None:
        n = config.num_scales
        self.count = n
        self.rate = np.float32(config.scale_learning_rate)
        self.regularization = np.float32(config.scale_regularization)
        self.epsilon = np.float32(config.hog_epsilon)
        self.base_size = base_size
        shrink = sqrt(config.scale_max_area / (base_size[0] * base_size[1]))
        self.width, self.height = (_sample_side(side * shrink) for side in base_size)
        lanes = -(-n // LANES) * LANES
        exponents = np.arange(n) - n // 2
        self.factors = np.ones(lanes, np.float32)
        self.factors[:n] = config.scale_step**exponents
        self.window = np.zeros(lanes, np.float32)
        self.window[:n] = np.hanning(n + 2)[1:-1]
        # the DFT over scales as one matrix: n is small and odd, and a matrix product beats any transform
        frequencies = np.arange(n // 2 + 1)
        angles = 2 * np.pi * np.outer(np.arange(n), frequencies) / n
        self.dft = np.zeros((lanes, 2 * len(frequencies)), np.float32)
        self.dft[:n, ::2], self.dft[:n, 1::2] = np.cos(angles), -np.sin(angles)
        label = np.exp(-0.5 * (exponents / (sqrt(n) * config.scale_sigma_factor)) ** 2)
        self.label_f = np.fft.rfft(label).astype(np.complex64)
        features = CHANNELS * (self.width // CELL) * (self.height // CELL)
        self.numerator = np.zeros((features, len(frequencies)), np.complex64)
        self.denominator = np.zeros(len(frequencies), np.float32)

    def estimate(self, spectra: Spectra) -> float:
        """The factor by which the target's size differs from the one that ``spectra`` were taken at."""
        response_f = np.empty(len(self.denominator), np.complex64)
        respond_scales(spectra, self.numerator, self.denominator, self.regularization, response_f)
        response = np.fft.irfft(response_f, self.count)
        best, same = response.argmax(), self.count // 2
        return float(self.factors[best if response[best] > response[same] else same])

    def learn(self, spectra: Spectra, first: bool = False) -> None:
        """Move the filter towards the target, whose present size ``spectra`` were taken at."""
        rate = np.float32(1) if first else self.rate
        learn_scales(spectra, self.label_f, rate, self.numerator, self.denominator)

    def clamp(self, scale: float, frame_size: tuple[int, int]) -> float:
        """``scale`` within what makes sense: a few pixels at least, the frame at most."""
        w, h = self.base_size
        lowest = min(1.0, MIN_SIDE / min(w, h))
        highest = max(1.0, min(frame_size[0] / w, frame_size[1] / h))
        return min(max(scale, lowest), highest)

    def spectra(self, frame: Frame, within: Rect, center: tuple[float, float], scale: float) -> Spectra:
        """DFT over scales of every feature, (features, count // 2 + 1) complex64; scratch, until the next call."""
        w, h = self.base_size[0] * scale, self.base_size[1] * scale
        largest = float(self.factors[: self.count].max())
        gray, (cx, cy), (fx, fy) = _gray_cut(frame, within, center, (w, h), largest, (self.width, self.height))
        lanes = len(self.factors)
        samples = scratch("scale_samples", (self.height, self.width, lanes))
        step_x = self.factors * np.float32(w / self.width / fx)
        step_y = self.factors * np.float32(h / self.height / fy)
        sample_scales(gray, np.float32(cx), np.float32(cy), step_x, step_y, samples)
        ny, nx = self.height // CELL, self.width // CELL
        features = scratch("scale_features", (ny * nx * CHANNELS, lanes))
        scale_hog(
            samples,
            self.epsilon,
            scratch("scale_cells", (ny, nx, SIGNED, lanes)),
            scratch("scale_norms", (ny + 1, nx + 1, lanes)),
            self.window,
            features,
        )
        spectra = scratch("scale_spectra", (len(features), self.dft.shape[1]))
        # cell by cell: products too small for a BLAS to bring its threads to, which cost more than they save
        cells = (ny * nx, CHANNELS, -1)
        np.matmul(features.reshape(cells), self.dft, out=spectra.reshape(cells))
        return spectra.view(np.complex64)


def _sample_side(side: float) -> int:
    """A whole number of cells near ``side``; a sliver of a target does not make a sliver of a sample."""
    return min(max(round(side / CELL) * CELL, 2 * CELL), MAX_SAMPLE_SIDE)


def _gray_cut(
    frame: Frame,
    within: Rect,
    center: tuple[float, float],
    size: tuple[float, float],
    largest: float,
    sample_size: tuple[int, int],
) -> tuple[Image, tuple[float, float], tuple[float, float]]:
    """Grey pixels around the target with room for the largest scale, thinned to what the samples need.

    Returns the pixels, the centre in them and the image pixels each stands for.
    """
    out, cut = [], []
    for length, samples in zip(size, sample_size, strict=True):
        whole = max(2, round(length * largest) + 2)
        cut.append(whole)
        out.append(min(whole, round(OVERSAMPLING * samples * largest) + 2))
    x, y = round(center[0] - cut[0] / 2), round(center[1] - cut[1] / 2)
    pixels = frame.sample((x, y, cut[0], cut[1]), within, (out[0], out[1]))
    gray = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    factor = (cut[0] / out[0], cut[1] / out[1])
    return gray, ((center[0] - x) / factor[0], (center[1] - y) / factor[1]), factor  # type: ignore[return-value]
