"""The scale filter of DSST (Danelljan et al., BMVC 2014): a one-dimensional correlation filter over sizes."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, sqrt

import cv2
import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .geometry import CELL, Frame, Image, Rect
from .kernels.hog import CHANNELS, SIGNED
from .kernels.scale import learn_scales, respond_scales, scale_hog
from .workspace import scratch

LANES = 8
"""The scales to each side are padded to a multiple of this many SIMD lanes."""
MAX_SAMPLE_SIDE = 64
"""Pixels: together with the area this bounds the cost for targets of any aspect."""
MIN_SIDE = 5.0
"""Pixels; a target is not followed below this size, unless it began smaller."""
OVERSAMPLING = 2.0
"""Pixels of the grey cut a sample of scale 1, at most: enough that the smallest scale does not alias."""


@dataclass(frozen=True, slots=True)
class Spectra:
    """DFT over scales of each feature: M cosine and M sine sums, ``waves`` (features, 2 M) float32, and the sum.

    M is the number of scales to each side, padded; ``sums`` (features,) float32 is frequency 0.
    """

    waves: npt.NDArray[np.float32]
    sums: npt.NDArray[np.float32]


class ScaleModel:
    """Finds the target's size among ``num_scales`` steps around the last one.

    ``scale_samples`` samples over the same range: the target's box at that size, resized to at most
    ``scale_max_area`` pixels, as fHOG; the filter is the ridge regression of equation 1 along the axis of scales,
    with a Gaussian label and a Hann window over it. Numerator and denominator are running means; the label is the
    same in every frame, so that the numerator is kept without it. The response is a sum of waves and can be had
    at any scale (fDSST: Danelljan et al., PAMI 2017).

    Spectra count from the present scale, so that the symmetric label's is real. They are real arrays, see
    :class:`Spectra`.
    """

    def __init__(self, config: MFCMTConfig, base_size: tuple[float, float]) -> None:
        n = min(config.scale_samples, config.num_scales)
        reach = n // 2
        side = -(-reach // LANES) * LANES
        self.count = n
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
        self.largest = sample_step**reach
        distance = np.arange(1, side + 1)
        lanes = np.concatenate([-distance, distance])  # in the order of kernels.scale
        self.present = reach if reach < side else 2 * side
        if reach == side:
            lanes = np.append(lanes, np.full(LANES, side + 1))
        lanes[self.present] = 0
        inside = abs(lanes) <= reach
        self.lane_factors = np.where(inside, sample_step**lanes, 1).astype(np.float32)
        self.window = np.where(inside, 0.5 + 0.5 * np.cos(np.pi * lanes / (reach + 1)), 0).astype(np.float32)
        # n is small and odd: a matrix product beats any transform
        angles = 2 * np.pi / n * np.outer(np.arange(side + 1), distance)
        known = (np.arange(side + 1) <= reach)[:, None] & (distance <= reach)
        self.cosines = (np.cos(angles) * known).astype(np.float32)
        self.sines = (np.sin(angles) * known)[1:].astype(np.float32)
        self.ones = np.ones(side + 1, np.float32)
        steps = np.arange(-reach, reach + 1)
        label = np.exp(-0.5 * (steps * spacing / (sqrt(config.num_scales) * config.scale_sigma_factor)) ** 2)
        self.label_f = (label @ np.cos(2 * np.pi / n * np.outer(steps, np.append(distance, 0)))).astype(np.float32)
        frequencies = 2 * np.pi / n * distance * (distance <= reach)
        angles = np.outer(fine / spacing, frequencies)
        back = np.concatenate([2 * np.cos(angles), 2 * np.sin(angles), np.ones((len(fine), 1))], axis=1)
        self.inverse = (back / n).astype(np.float32)
        self.angle_of_growth = (frequencies / np.log(sample_step)).astype(np.float32)
        features = CHANNELS * (self.width // CELL) * (self.height // CELL)
        self.mean = Spectra(np.zeros((features, 2 * side), np.float32), np.zeros(features, np.float32))
        self.energy = np.zeros(side + 1, np.float32)

    def estimate(self, spectra: Spectra) -> float:
        """The factor by which the target's size differs from the one that ``spectra`` were taken at."""
        mean, label = self.mean, self.label_f
        response_f = scratch("scale_response", (2 * len(label) - 1,))
        respond_scales(
            spectra.waves, spectra.sums, mean.waves, mean.sums, label, self.energy, self.regularization, response_f
        )
        response = self.inverse @ response_f
        best, same = response.argmax(), len(self.factors) // 2
        return float(self.factors[best if response[best] > response[same] else same])

    def learn(self, spectra: Spectra, growth: float = 1.0, first: bool = False) -> None:
        """Move the filter towards the target, which is ``growth`` times the size that ``spectra`` were taken at."""
        rate = np.float32(1) if first else self.rate
        angles = self.angle_of_growth * np.float32(log(growth))
        learn_scales(spectra.waves, spectra.sums, angles, rate, self.mean.waves, self.mean.sums, self.energy)

    def clamp(self, scale: float, frame_size: tuple[int, int]) -> float:
        """``scale`` within what makes sense: a few pixels at least, the frame at most."""
        w, h = self.base_size
        lowest = min(1.0, MIN_SIDE / min(w, h))
        highest = max(1.0, min(frame_size[0] / w, frame_size[1] / h))
        return min(max(scale, lowest), highest)

    def spectra(self, frame: Frame, within: Rect, center: tuple[float, float], scale: float) -> Spectra:
        """What the target's surroundings at that centre look like at each scale; scratch, until the next call."""
        w, h = self.base_size[0] * scale, self.base_size[1] * scale
        gray, (cx, cy), (fx, fy) = _gray_cut(frame, within, center, (w, h), self.largest, (self.width, self.height))
        lanes, side = len(self.lane_factors), len(self.sines)
        ny, nx = self.height // CELL, self.width // CELL
        even = scratch("scale_even", (ny * nx * CHANNELS, side + 1))
        odd = scratch("scale_odd", (ny * nx * CHANNELS, side))
        scale_hog(
            gray,
            np.float32(cx),
            np.float32(cy),
            self.lane_factors * np.float32(w / self.width / fx),
            self.lane_factors * np.float32(h / self.height / fy),
            self.present,
            self.epsilon,
            self.window,
            scratch("quads", gray.shape, np.uint32),
            scratch("scale_samples", (self.height, self.width, lanes)),
            scratch("scale_histogram", (ny * nx + 1, SIGNED, lanes)),
            scratch("scale_norms", (ny + 1, nx + 1, lanes)),
            even,
            odd,
        )
        spectra = Spectra(scratch("scale_waves", (len(even), 2 * side)), scratch("scale_sums", (len(even),)))
        # cell by cell: products too small for a BLAS to bring its threads to, which cost more than they save
        cells = (ny * nx, CHANNELS, -1)
        waves = spectra.waves.reshape(cells)
        np.matmul(even.reshape(cells), self.cosines, out=waves[..., :side])
        np.matmul(odd.reshape(cells), self.sines, out=waves[..., side:])
        np.matmul(even, self.ones, out=spectra.sums)
        return spectra


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
