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
    """One filter for each cue, or a single one for all of them together (``config.joint_filter``).

    Spectra are unnormalised half spectra (channels, n, n // 2 + 1) complex64 of the n × n cells; λ is
    scaled by n², which makes it the λ of a regression with normalised transforms. Equation 3 needs the
    conjugate of the filter, which the paper's print leaves out.

    ``numerator`` (channels, n, n // 2 + 1) is what equation 11 averages: W, or the numerator of equation 2 without
    the label, which is the same in every frame. Then ``denominator`` (models, n, n // 2 + 1) is the other mean and
    ``quotient`` what both leave to multiply a response with.
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
        self.background_filters = self.numerator[:0]  # no channels: no such model
        self.interval = config.background_interval
        if self.interval:
            self.background = BackgroundAwareFilter(search_window, shape[0], self.label_f, config.regularization)
            self.background_filters = self.background.filters
            self.names += ("background",)

    def spectra(self, patch: Image, gray: Image) -> Spectra:
        """Half spectra of the windowed features of ``patch``, (channels, n, n // 2 + 1) complex64."""
        return self.transform.forward(self.features.extract(patch, gray))

    def respond(self, spectra: Spectra, out: npt.NDArray[np.float32]) -> None:
        """Responses within reach into ``out`` (maps, 2·ry + 1, 2·rx + 1), in the order of ``names``."""
        response_f = scratch("response_f", (len(self.names), *spectra.shape[1:]), np.complex64)
        respond_filters(self.numerator, self.quotient, self.blocks, self.background_filters, spectra, response_f)
        self.transform.backward(response_f, out)

    def respond_by_cue(self, spectra: Spectra) -> dict[str, npt.NDArray[np.float32]]:
        """What each cue adds to the response of a joint filter, (2·ry + 1, 2·rx + 1), by cue: to look at."""
        blocks = np.array([(b.start, b.stop) for b in self.features.blocks.values()], np.int64)
        parts_f = np.empty((len(blocks), *spectra.shape[1:]), np.complex64)
        quotient = np.broadcast_to(self.quotient, parts_f.shape)  # of a joint filter they have it in common
        respond_filters(self.numerator, np.ascontiguousarray(quotient), blocks, self.numerator[:0], spectra, parts_f)
        parts = np.empty((len(blocks), 2 * self.transform.reach[1] + 1, 2 * self.transform.reach[0] + 1), np.float32)
        self.transform.backward(parts_f, parts)
        return dict(zip(self.features.blocks, parts, strict=True))

    def learn(self, spectra: Spectra, offset: tuple[float, float] = (0.0, 0.0), learned: int | None = None) -> None:
        """Learn a patch of the target at the learning rate (equation 11), or at 1 the first time.

        ``offset`` (x, y) in cells is where in the patch the target's centre is; ``spectra`` are turned to have it
        in the middle. ``learned`` counts the frames learned before this one since the first; None is the first.
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
        """Compute the gain from the denominator."""
        if self.average == "spectra":
            divide_label(self.label_f, self.denominator, self.regularization, self.quotient)
