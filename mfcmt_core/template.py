"""The template models: correlation filters by ridge regression (equations 1–3)."""

from __future__ import annotations

from math import sqrt

import numpy as np
import numpy.typing as npt

from .background import BackgroundAwareFilter
from .config import MFCMTConfig
from .features import FeatureStack
from .fourier import Spectra, Transform
from .geometry import Image, SearchWindow
from .kernels.template import (
    divide_label,
    energy,
    learn_filters,
    learn_shifted_spectra,
    phase_shift,
    respond_filters,
)
from .workspace import scratch


class TemplateModel:
    """One correlation filter per cue, or one for all cues together (``config.joint_filter``).

    Spectra are unnormalized half spectra (channels, n, n // 2 + 1) complex64 of the n × n cells. λ is scaled by n²,
    so that it equals the λ of a regression with normalized transforms. Equation 3 needs the conjugate of the filter,
    which the printed paper omits.

    A filter is ``numerator`` (channels, n, n // 2 + 1) complex64 times ``quotient`` (models, n, n // 2 + 1) complex64.

    * With ``average="spectra"``, equation 11 averages the two parts of equation 2. The label is the same in every
      frame, so ``numerator`` is the mean of the spectra without it, ``denominator`` (models, n, n // 2 + 1) float32 is
      the mean energy, and ``quotient`` is label / (denominator + λ).
    * With ``average="filter"``, equation 11 averages the filter itself: ``numerator`` is W and ``quotient`` is 1.

    References
    ----------
    J. F. Henriques, R. Caseiro, P. Martins and J. Batista, "High-Speed Tracking with Kernelized Correlation Filters",
    TPAMI 2015, arXiv:1404.7584. H. K. Galoogahi, T. Sim and S. Lucey, "Multi-Channel Correlation Filters", ICCV 2013,
    doi:10.1109/ICCV.2013.381.
    """

    def __init__(self, config: MFCMTConfig, search_window: SearchWindow, is_gray: bool) -> None:
        self.features = FeatureStack(config, is_gray)
        self.transform = Transform(search_window.cells, search_window.reach)
        self.average = config.average
        self.rate = np.float32(config.template_learning_rate)
        n = search_window.cells
        self.regularization = np.float32(config.regularization * n * n)
        blocks = list(self.features.blocks.values())
        if config.joint_filter:
            blocks = [slice(0, self.features.channels)]
        self.names = ("template",) if config.joint_filter else tuple(self.features.blocks)
        self.blocks = np.array([(b.start, b.stop) for b in blocks], np.int64)
        sigma = config.output_sigma_factor * sqrt(search_window.target[0] * search_window.target[1])
        distance = np.fft.fftfreq(n) * n  # zero displacement at index 0
        bell = np.exp(-0.5 * (distance / sigma) ** 2)
        self.label_f = np.fft.rfft2(np.outer(bell, bell)).astype(np.complex64)
        shape = (self.features.channels, n, n // 2 + 1)
        self.numerator = np.zeros(shape, np.complex64)
        self.denominator = np.zeros((len(blocks), *shape[1:]), np.float32)
        self.quotient = np.ones((len(blocks), *shape[1:]), np.complex64)
        self.background: BackgroundAwareFilter | None = None
        self.background_filters = self.numerator[:0]  # without channels: there is no such model
        self.interval = config.background_interval
        if self.interval:
            self.background = BackgroundAwareFilter(search_window, shape[0], self.label_f, config.regularization)
            self.background_filters = self.background.filters
            self.names += ("background",)

    def spectra(self, patch: Image, gray: Image) -> Spectra:
        """Return the half spectra of the windowed features of ``patch``, (channels, n, n // 2 + 1) complex64."""
        return self.transform.forward(self.features.extract(patch, gray))

    def respond(self, spectra: Spectra, out: npt.NDArray[np.float32]) -> None:
        """Write the responses within reach to ``out`` (maps, 2·ry + 1, 2·rx + 1) float32, in the order of ``names``."""
        response_f = scratch("response_f", (len(self.names), *spectra.shape[1:]), np.complex64)
        respond_filters(self.numerator, self.quotient, self.blocks, self.background_filters, spectra, response_f)
        self.transform.backward(response_f, out)

    def respond_by_cue(self, spectra: Spectra) -> dict[str, npt.NDArray[np.float32]]:
        """Return by cue what it adds to the response of a joint filter, (2·ry + 1, 2·rx + 1) float32, for display."""
        blocks = np.array([(b.start, b.stop) for b in self.features.blocks.values()], np.int64)
        parts_f = np.empty((len(blocks), *spectra.shape[1:]), np.complex64)
        quotient = np.broadcast_to(self.quotient, parts_f.shape)  # the cues of a joint filter share it
        respond_filters(self.numerator, np.ascontiguousarray(quotient), blocks, self.numerator[:0], spectra, parts_f)
        parts = np.empty((len(blocks), 2 * self.transform.reach[1] + 1, 2 * self.transform.reach[0] + 1), np.float32)
        self.transform.backward(parts_f, parts)
        return dict(zip(self.features.blocks, parts, strict=True))

    def learn(self, spectra: Spectra, offset: tuple[float, float] = (0.0, 0.0), learned: int | None = None) -> None:
        """Learn a window of the target with the learning rate (equation 11).

        Parameters
        ----------
        spectra : ndarray of complex64, shape (channels, n, n // 2 + 1)
            The window's spectra. They are changed: their phase is shifted to have the target in the middle.
        offset : (float, float)
            Cells (x, y) from the middle of the window to the target's center.
        learned : int or None
            Number of frames learned since the first one; None for the first one, which is learned with rate 1.
        """
        first = learned is None
        rate = np.float32(1) if first else self.rate
        if self.average == "spectra":
            blocks, label_f, regularization = self.blocks, self.label_f, self.regularization
            learn_shifted_spectra(
                spectra, *offset, blocks, rate, label_f, regularization, self.numerator, self.denominator, self.quotient
            )
        else:
            if any(offset):
                phase_shift(spectra, *offset)
            energies = scratch("energies", self.denominator.shape)
            for block, out in zip(self.blocks, energies, strict=True):
                energy(spectra, block, out)
            learn_filters(spectra, self.label_f, self.blocks, self.regularization, rate, energies, self.numerator)
        if self.background and (learned is None or learned % self.interval == self.interval - 1):
            self.background.train(self.numerator, first)

    def refresh(self) -> None:
        """Compute ``quotient`` from ``denominator``."""
        if self.average == "spectra":
            divide_label(self.label_f, self.denominator, self.regularization, self.quotient)
