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
from .kernels.template import energy, learn_filters, learn_spectra, respond_filters
from .workspace import scratch

LEAST_LABEL = 1e-6
"""Of the label's largest frequency: below it there is nothing to divide by."""


class TemplateModel:
    """One filter for each cue, or a single one for all of them together (``config.joint_filter``).

    Spectra are unnormalised half spectra (channels, n, n // 2 + 1) complex64 of the n × n cells; λ is
    scaled by n², which makes it the λ of a regression with normalised transforms. Equation 3 needs the
    conjugate of the filter, which the paper's print leaves out.
    """

    def __init__(self, config: MFCMTConfig, window: SearchWindow, grey: bool) -> None:
        self.features = FeatureStack(config, grey)
        self.transform = Transform(window.cells, window.reach)
        self.average = config.average
        self.rate = np.float32(config.template_learning_rate)
        n = window.cells
        self.regularization = np.float32(config.regularization * n * n)
        blocks = list(self.features.blocks.values())
        if config.joint_filter:
            blocks = [slice(0, self.features.channels)]
        self.names = ("template",) if config.joint_filter else tuple(self.features.blocks)
        self.blocks = np.array([(b.start, b.stop) for b in blocks], np.int64)
        sigma = config.output_sigma_factor * sqrt(window.target[0] * window.target[1])
        distance = np.fft.fftfreq(n) * n  # zero displacement at index 0
        bell = np.exp(-0.5 * (distance / sigma) ** 2)
        self.label_f = np.fft.rfft2(np.outer(bell, bell)).astype(np.complex64)
        shape = (self.features.channels, n, n // 2 + 1)
        self.filters = np.zeros(shape, np.complex64)
        if self.average == "spectra":
            self.mean = np.zeros(shape, np.complex64)
            self.denominator = np.zeros((len(blocks), *shape[1:]), np.float32)
        self.background: BackgroundAwareFilter | None = None
        self.interval = config.background_interval
        if self.interval:
            self.background = BackgroundAwareFilter(window, shape[0], self.label_f, config.regularization)
            self.names += ("background",)

    def adopt(self, numerator: Spectra) -> None:
        """Take over a mean that is given times the label's conjugate, as equation 2 has it."""
        label = np.conj(self.label_f)
        np.divide(numerator, label, out=self.mean, where=np.abs(label) > LEAST_LABEL * np.abs(label).max())

    def spectra(self, patch: Image) -> Spectra:
        """Half spectra of the windowed features of ``patch``, (channels, n, n // 2 + 1) complex64."""
        return self.transform.forward(self.features.extract(patch))

    def respond(self, spectra: Spectra, out: npt.NDArray[np.float32]) -> float:
        """Responses within reach into ``out`` (models, 2·ry + 1, 2·rx + 1); the mean of the ridge filters' peaks."""
        models = len(self.blocks)
        response_f = scratch("response_f", (len(self.names), *spectra.shape[1:]), np.complex64)
        respond_filters(self.filters, spectra, self.blocks, response_f[:models])
        if self.background:
            respond_filters(self.background.filters, spectra, self.background.all_channels, response_f[models:])
        out[...] = self.transform.backward(response_f)
        return float(sum(response.max() for response in out[:models]) / models)

    def respond_by_cue(self, spectra: Spectra) -> dict[str, npt.NDArray[np.float32]]:
        """What each cue adds to the response of a joint filter, (2·ry + 1, 2·rx + 1), by cue: to look at."""
        blocks = np.array([(b.start, b.stop) for b in self.features.blocks.values()], np.int64)
        parts_f = np.empty((len(blocks), *spectra.shape[1:]), np.complex64)
        respond_filters(self.filters, spectra, blocks, parts_f)
        return dict(zip(self.features.blocks, self.transform.backward(parts_f), strict=True))

    def learn(self, spectra: Spectra, learned: int | None = None) -> None:
        """Learn a patch centred on the target at the learning rate (equation 11), or at 1 the first time.

        ``learned`` counts the frames learned before this one since the first; None is the first.
        """
        first = learned is None
        energies = scratch("energies", (len(self.blocks), *spectra.shape[1:]))
        for block, out in zip(self.blocks, energies, strict=True):
            energy(spectra, block, out)
        rate = np.float32(1) if first else self.rate
        common = (spectra, self.label_f, self.blocks, self.regularization, rate, energies)
        if self.average == "spectra":
            learn_spectra(*common, self.mean, self.denominator, self.filters)
        else:
            learn_filters(*common, self.filters)
        if self.background and (learned is None or learned % self.interval == self.interval - 1):
            self.background.train(self.mean)
