"""How true a tracker's confidence is: ranking, calibration, and what its status is worth.

A frame is right where the overlap is above 0.5 and wrong where it is below 0.1. Each sequence weighs alike in every
figure, whatever its length and its number of runs. Frames in which the target is absent count for the figures of
:func:`long_term` and for the share of absent frames called tracking alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as Seq
from dataclasses import dataclass

import numpy as np

from .metrics import Array, Mask

RIGHT = 0.5
WRONG = 0.1
REFUSED = 0.05
"""Share of right frames that may be refused, where the share of wrong ones that are caught is given."""
BINS = 10
"""Of the reliability diagram and of the calibration error."""
RESAMPLES = 500
STATUSES = ("tracking", "uncertain", "lost")


@dataclass(frozen=True, eq=False)
class Judged:
    """What a tracker said about the frames of one sequence, all its runs together, and how right it was.

    ``overlap`` (N,) is NaN where the target is absent, ``confidence`` (N,) any number that grows with trust,
    ``status`` (N,) indexes :data:`STATUSES`, NaN where the tracker has none.
    """

    name: str
    overlap: Array
    confidence: Array
    status: Array

    @property
    def present(self) -> Mask:
        """Return the frames with a target."""
        return np.isfinite(self.overlap)


@dataclass(frozen=True, eq=False)
class Pool:
    """Frames of several sequences with the target in them; those of a sequence have total weight 1."""

    overlap: Array
    confidence: Array
    status: Array
    weight: Array

    @classmethod
    def of(cls, sequences: Iterable[Judged]) -> Pool:
        """Return all frames of these sequences in which the target is present."""
        parts = [(j, j.present) for j in sequences if j.present.any()]
        return cls(
            np.concatenate([j.overlap[p] for j, p in parts]),
            np.concatenate([j.confidence[p] for j, p in parts]),
            np.concatenate([j.status[p] for j, p in parts]),
            np.concatenate([np.full(p.sum(), 1 / p.sum()) for _, p in parts]),
        )

    @property
    def is_probability(self) -> bool:
        """Return whether all confidences lie in [0, 1]."""
        return bool(self.confidence.min() >= 0 and self.confidence.max() <= 1)

    @property
    def right(self) -> Mask:
        return np.asarray(self.overlap > RIGHT)

    @property
    def wrong(self) -> Mask:
        return np.asarray(self.overlap < WRONG)


def auroc(score: Array, right: Mask, weight: Array) -> float:
    """Return the probability that a right frame scores higher than another, ties counted half; NaN without both."""
    values, place = np.unique(score, return_inverse=True)
    positive = np.bincount(place, weight * right, len(values))
    negative = np.bincount(place, weight * ~right, len(values))
    total = positive.sum() * negative.sum()
    if not total:
        return float("nan")
    below = np.cumsum(negative) - negative / 2
    return float((positive * below).sum() / total)


def caught(score: Array, right: Mask, wrong: Mask, weight: Array, refused: float = REFUSED) -> float:
    """Return the share of wrong frames whose score is below a limit; NaN without right and wrong frames.

    The limit is the score below which the share ``refused`` of the right frames lies.
    """
    if not right.any() or not wrong.any():
        return float("nan")
    limit = weighted_quantile(score[right], weight[right], refused)
    return float(weight[wrong & (score < limit)].sum() / weight[wrong].sum())


def weighted_quantile(values: Array, weight: Array, share: float) -> float:
    """Return the smallest value up to which at least that share of the weight lies."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weight[order])
    return float(values[order][min(np.searchsorted(reached, share * reached[-1]), len(values) - 1)])


@dataclass(frozen=True, eq=False)
class Calibration:
    """A reliability diagram: of each bin of confidence its mean, the share of right frames, and its weight."""

    confidence: Array
    right: Array
    weight: Array

    @property
    def error(self) -> float:
        """Return the expected calibration error: over bins, the mean of abs(confidence - share of right frames)."""
        known = self.weight > 0
        return float((self.weight * np.abs(self.confidence - self.right))[known].sum() / self.weight.sum())


def calibration(confidence: Array, right: Mask, weight: Array, bins: int = BINS) -> Calibration:
    """Return the reliability diagram of confidences in [0, 1]; empty bins hold NaN."""
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    total = np.bincount(place, weight, bins)
    with np.errstate(invalid="ignore"):
        return Calibration(
            np.bincount(place, weight * confidence, bins) / total,
            np.bincount(place, weight * right, bins) / total,
            np.asarray(total, np.float64),
        )


def risk_coverage(score: Array, right: Mask, weight: Array) -> tuple[Array, Array]:
    """Return the share of frames accepted, from the highest score down, and of not-right ones among them, ``(N,)``."""
    order = np.argsort(-score, kind="stable")
    accepted = np.cumsum(weight[order])
    return accepted / accepted[-1], np.cumsum((weight * ~right)[order]) / accepted


def status_table(pool: Pool) -> Array:
    """Return the share of frames by truth and status; each row sums to 1, or is NaN.

    Rows are right, between and wrong; columns are :data:`STATUSES`.
    """
    rows = (pool.right, ~pool.right & ~pool.wrong, pool.wrong)
    table = np.array([[pool.weight[row & (pool.status == k)].sum() for k in range(len(STATUSES))] for row in rows])
    with np.errstate(invalid="ignore"):
        return np.asarray(table / table.sum(axis=1, keepdims=True))


def tracked_wrong(pool: Pool) -> float:
    """Return the share of wrong frames among those called tracking."""
    tracking = pool.status == STATUSES.index("tracking")
    return float(pool.weight[tracking & pool.wrong].sum() / pool.weight[tracking].sum()) if tracking.any() else 0.0


@dataclass(frozen=True)
class LongTerm:
    """Precision, recall and F of VOT-LT at the confidence that makes F largest."""

    precision: float
    recall: float
    f: float
    threshold: float


def long_term(sequences: Seq[Judged]) -> LongTerm:
    """Return VOT's long-term measures (Lukežič et al., 2018, arXiv:1804.07056).

    Boxes below a threshold count as not given. Precision is the mean overlap over the frames with a box, 0 where the
    target is absent. Recall is the mean overlap over the frames with a target, 0 where there is no box. Each sequence
    has the same weight.
    """
    thresholds = np.unique(np.concatenate([j.confidence for j in sequences]))
    if len(thresholds) > 200:
        thresholds = np.quantile(thresholds, np.linspace(0, 1, 200))
    best = LongTerm(0.0, 0.0, 0.0, float(thresholds[0]))
    for threshold in thresholds:
        precisions, recalls = [], []
        for j in sequences:
            given, overlap = j.confidence >= threshold, np.nan_to_num(j.overlap)
            precisions.append(overlap[given].mean() if given.any() else 1.0)
            recalls.append((overlap * given)[j.present].mean() if j.present.any() else 0.0)
        precision, recall = float(np.mean(precisions)), float(np.mean(recalls))
        f = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
        if f > best.f:
            best = LongTerm(precision, recall, f, float(threshold))
    return best


def absent_tracked(sequences: Iterable[Judged]) -> float:
    """Return the share of the frames without a target that are called tracking; NaN if there are none.

    Each sequence with such frames has the same weight.
    """
    shares = [np.mean(j.status[~j.present] == STATUSES.index("tracking")) for j in sequences if not j.present.all()]
    return float(np.mean(shares)) if shares else float("nan")


@dataclass(frozen=True)
class Trust:
    """The figures of one tracker; each interval is a 95 % bootstrap over sequences. NaN where one has no meaning."""

    auroc: float
    auroc_interval: tuple[float, float]
    caught: float
    caught_interval: tuple[float, float]
    calibration_error: float
    sequences: int


def measure(sequences: Seq[Judged], seed: int = 0) -> Trust:
    """Return ranking and calibration of a tracker's confidence over these sequences."""
    sequences = [j for j in sequences if j.present.any()]

    def figures(some: Seq[Judged]) -> tuple[float, float]:
        pool = Pool.of(some)
        right, wrong = pool.right, pool.wrong
        return auroc(pool.confidence, right, pool.weight), caught(pool.confidence, right, wrong, pool.weight)

    rng = np.random.default_rng(seed)
    whole = figures(sequences)
    picks = rng.integers(0, len(sequences), (RESAMPLES, len(sequences)))
    drawn = np.array([figures([sequences[i] for i in pick]) for pick in picks])
    pool = Pool.of(sequences)
    return Trust(
        whole[0],
        _interval(drawn[:, 0]),
        whole[1],
        _interval(drawn[:, 1]),
        calibration(pool.confidence, pool.right, pool.weight).error if pool.is_probability else float("nan"),
        len(sequences),
    )


def _interval(drawn: Array) -> tuple[float, float]:
    """Return the middle 95 % of the resampled figures that have a value."""
    known = drawn[np.isfinite(drawn)]
    if not len(known):
        return float("nan"), float("nan")
    low, high = np.quantile(known, (0.025, 0.975))
    return float(low), float(high)
