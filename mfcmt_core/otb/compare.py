"""Is one tracker better than another, or was it luck? Paired bootstrap over the sequences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from .score import Evaluation

TIE = 0.01
"""Sequences that differ by less count as neither won nor lost."""


@dataclass(frozen=True)
class Difference:
    """``mean`` of tracker minus reference over ``sequences`` that both have, with its 95 % interval.

    An interval that contains 0 is no evidence of a difference.
    """

    tracker: str
    reference: str
    metric: str
    mean: float
    low: float
    high: float
    won: int
    lost: int
    sequences: int

    @property
    def is_evidence(self) -> bool:
        """Return whether the interval leaves out 0."""
        return self.low > 0 or self.high < 0


def compare(
    tracker: Evaluation,
    reference: Evaluation,
    metric: str = "success",
    *,
    samples: int = 10_000,
    seed: int = 0,
) -> Difference:
    """Return the difference in ``success``, ``precision`` or ``norm_precision`` with its bootstrap interval.

    The sequences are drawn with replacement, the same ones for both trackers; the interval is the percentile
    interval of Efron (1979), https://doi.org/10.1214/aos/1176344552.
    Raises DataError if the two have no sequence in common.
    """
    common = [name for name in tracker.scores if name in reference.scores]
    if not common:
        raise DataError(f"{tracker.tracker} and {reference.tracker} have no sequence in common")
    difference = np.array([getattr(tracker.scores[n], metric) - getattr(reference.scores[n], metric) for n in common])
    drawn = np.random.default_rng(seed).integers(len(common), size=(samples, len(common)))
    low, high = np.percentile(difference[drawn].mean(axis=1), [2.5, 97.5])
    return Difference(
        tracker.tracker,
        reference.tracker,
        metric,
        float(difference.mean()),
        float(low),
        float(high),
        int((difference >= TIE).sum()),
        int((difference <= -TIE).sum()),
        len(common),
    )
