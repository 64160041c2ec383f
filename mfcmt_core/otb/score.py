"""From boxes to scores: one sequence, then a tracker over a benchmark."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ..errors import DataError
from . import metrics
from .dataset import NO_AREA, ONE_BASED, Dataset, Sequence
from .metrics import Array, Mask
from .protocol import PROTOCOLS, Run, to_original_size


@dataclass(frozen=True)
class Speed:
    """How long a tracker took: ``frames`` in ``seconds`` of wall and of CPU time (None where unknown).

    ``mean_rate`` is the mean of the frames' rates in Hz.
    """

    frames: int
    seconds: float
    mean_rate: float
    cpu_seconds: float | None = None


@dataclass(frozen=True, eq=False)
class SequenceScore:
    """Curves of one sequence, all runs pooled: ``(21,)`` for success, ``(51,)`` for precision."""

    success_curve: Array
    precision_curve: Array
    norm_precision_curve: Array
    frames: int
    speed: Speed | None = None

    @property
    def success(self) -> float:
        """Return the area under the success curve: the mean of its 21 values."""
        return float(self.success_curve.mean())

    @property
    def precision(self) -> float:
        """Return the share of frames within 20 pixels."""
        return float(self.precision_curve[metrics.PRECISION_AT])

    @property
    def norm_precision(self) -> float:
        """Return the share of frames within 0.2 of the target's size."""
        return float(self.norm_precision_curve[metrics.NORM_PRECISION_AT])


@dataclass(frozen=True)
class Evaluation:
    """A tracker under one protocol. ``missing`` gives the reason for each sequence without a score."""

    tracker: str
    protocol: str
    scores: dict[str, SequenceScore]
    missing: dict[str, str] = field(default_factory=dict)

    def curve(self, name: str, sequences: Iterable[str] | None = None) -> Array:
        """Return the mean of ``success_curve``, ``precision_curve`` or ``norm_precision_curve`` over the sequences."""
        return np.asarray(np.mean([getattr(s, name) for s in self._chosen(sequences)], axis=0))

    def mean(self, name: str, sequences: Iterable[str] | None = None) -> float:
        """Return the mean of ``success``, ``precision`` or ``norm_precision`` over the sequences that have a score."""
        return float(np.mean([getattr(s, name) for s in self._chosen(sequences)]))

    @property
    def success(self) -> float:
        """Return the benchmark's success score."""
        return self.mean("success")

    @property
    def precision(self) -> float:
        """Return the benchmark's precision score."""
        return self.mean("precision")

    @property
    def norm_precision(self) -> float:
        """Return the mean normalized precision."""
        return self.mean("norm_precision")

    @property
    def fps(self) -> float | None:
        """Return frames over seconds of wall time, all sequences together; None if no time is known."""
        speeds = self._speeds()
        return sum(s.frames for s in speeds) / sum(s.seconds for s in speeds) if speeds else None

    @property
    def cpu_fps(self) -> float | None:
        """Return frames over seconds of CPU time, which a busy machine hardly changes; None if no time is known."""
        known = [(s.frames, s.cpu_seconds) for s in self._speeds() if s.cpu_seconds]
        return sum(frames for frames, _ in known) / sum(seconds for _, seconds in known) if known else None

    @property
    def mean_rate(self) -> float | None:
        """Return the mean over sequences of the mean of the frames' rates in Hz; None if no time is known.

        Other toolkits print this figure. It is higher than :attr:`fps`, since quick frames count more.
        """
        speeds = self._speeds()
        return float(np.mean([s.mean_rate for s in speeds])) if speeds else None

    def _speeds(self) -> list[Speed]:
        return [s.speed for s in self.scores.values() if s.speed is not None and s.speed.seconds > 0]

    def _chosen(self, names: Iterable[str] | None) -> list[SequenceScore]:
        chosen = [self.scores[n] for n in (self.scores if names is None else names) if n in self.scores]
        if not chosen:
            raise DataError(f"{self.tracker}: no {self.protocol} result for any of these sequences")
        return chosen


def score_runs(
    sequence: Sequence, runs: Iterable[tuple[Run, npt.ArrayLike]], speed: Speed | None = None
) -> SequenceScore:
    """Score the boxes of some runs on one sequence, their frames pooled.

    The rules are the toolkit's (Wu et al., 2013, https://doi.org/10.1109/CVPR.2013.312): a box without area or with
    NaN is replaced by the one before it, the first box of a run by the truth; a frame with an invalid annotation is
    lost for success and found for precision.

    Parameters
    ----------
    sequence : Sequence
        The sequence with its truth.
    runs : iterable of (Run, array of float, shape (N, 4))
        Each run and its boxes from its start to the last frame: x, y, w, h in pixels, 0-based.
    speed : Speed, optional
        How long the tracker took; it is kept beside the scores.

    Returns
    -------
    SequenceScore
        The curves and scores.

    Raises
    ------
    DataError
        The boxes of a run have another shape.
    """
    overlaps, errors, relative = [], [], []
    for run, raw in runs:
        boxes = np.array(raw, dtype=np.float64)
        truth = sequence.boxes[run.start :]
        if boxes.shape != truth.shape:
            raise DataError(f"{sequence.name}: boxes of shape {boxes.shape} for {len(truth)} frames")
        boxes = to_original_size(_repaired(boxes) + ONE_BASED, run.ratio) - ONE_BASED
        boxes[0] = truth[0]
        valid = sequence.valid[run.start :]
        counted = valid if sequence.skip_invalid else np.ones_like(valid)
        overlaps.append(np.where(valid, metrics.overlap(boxes, truth), -1.0)[counted])
        errors.append(np.where(valid, metrics.center_error(boxes, truth), -1.0)[counted])
        relative.append(np.where(valid, metrics.normalized_center_error(boxes, truth), -1.0)[counted])
    pooled = np.concatenate(overlaps)
    return SequenceScore(
        metrics.success_curve(pooled),
        metrics.precision_curve(np.concatenate(errors)),
        metrics.precision_curve(np.concatenate(relative), metrics.NORM_PRECISION_THRESHOLDS),
        len(pooled),
        speed,
    )


def score(dataset: Dataset, boxes: Mapping[str, npt.ArrayLike], tracker: str = "tracker") -> Evaluation:
    """Score the boxes of one pass (OPE) over a data set.

    Parameters
    ----------
    dataset : Dataset
        The sequences with their truth.
    boxes : mapping of str to array of float, shape (N, 4)
        The boxes of all frames by the sequence's name: x, y, w, h in pixels, 0-based.
    tracker : str, optional
        The name that the evaluation bears.

    Returns
    -------
    Evaluation
        Its ``missing`` names the sequences without boxes.

    Raises
    ------
    DataError
        The boxes of a sequence have another shape.
    """
    scores, missing = {}, {}
    for sequence in dataset:
        if sequence.name not in boxes:
            missing[sequence.name] = "no boxes"
            continue
        run = PROTOCOLS["OPE"](sequence)[0]
        scores[sequence.name] = score_runs(sequence, [(run, np.asarray(boxes[sequence.name])[run.start :])])
    return Evaluation(tracker, "OPE", scores, missing)


def _repaired(boxes: Array) -> Array:
    usable: Mask = np.all(np.isfinite(boxes) & (boxes > NO_AREA), axis=1)
    usable[0] = True  # the first is replaced by the truth anyway
    return np.asarray(boxes[np.maximum.accumulate(np.where(usable, np.arange(len(boxes)), 0))])
