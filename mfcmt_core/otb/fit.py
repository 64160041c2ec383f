"""Fits the constants of :mod:`mfcmt_core.confidence` and says what they are worth on data that they have not seen.

The tracker runs as it is over every sequence from several starts, on boxes that are a tenth off in some, so that
there are enough wrong frames. A logistic regression with ridge tells right frames from the others; each sequence
weighs alike. The figures are those of frames scored by constants that were fitted without their data set.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from collections.abc import Sequence as Seq
from dataclasses import dataclass

import numpy as np

from ..confidence import DEFAULT, WEIGHED
from ..config import MFCMTConfig
from ..errors import DataError
from ..geometry import Frame, Image, Rect
from ..search import Candidate
from ..target import Target
from ..tracker import MFCMT
from .batch import LOCAL, Lost, run_batch
from .dataset import Dataset, Sequence
from .metrics import Array, overlap
from .protocol import Run
from .trust import RIGHT, STATUSES, Judged

RIDGE = 1e-2
"""On standardised signals; a weaker one is worse on data sets that were left out."""
SHIFT = 0.1
"""Of the target's sides: how far a start may be off."""
FEWEST = 20
"""Frames that a run must have."""
STEPS = 50
"""Of Newton's method, at most."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """The runs of one sequence: ``signals`` (N, S) that the model weighs, and how right the box was.

    ``overlap`` (N,) is that of the box whose signals these are, NaN where the target is absent; ``reported`` (N,)
    that of the box in the result, which is older while the target is lost.
    """

    source: str
    name: str
    signals: Array
    overlap: Array
    reported: Array
    status: Array


class _Recorder(MFCMT):
    """Remembers where the search ended, also where the result keeps an older box."""

    def _search(self, target: Target, frame: Frame, readable: Rect) -> Candidate:
        candidate = super()._search(target, frame, readable)
        self.found = candidate.detection.center
        return candidate


def starts(sequence: Sequence) -> list[Run]:
    """Return four runs: two from the first frame (one a tenth off the true box), then from a third and two thirds."""
    rng = np.random.default_rng(zlib.crc32(sequence.name.encode()))
    known = np.flatnonzero(sequence.valid)
    runs = []
    for key, (share, moved) in enumerate([(0.0, False), (0.0, True), (1 / 3, True), (2 / 3, False)]):
        later = known[known >= share * len(sequence)]
        if not len(later) or len(sequence) - later[0] < FEWEST:
            continue
        x, y, w, h = sequence.boxes[later[0]]
        if moved:
            angle, factor = rng.uniform(0, 2 * np.pi), rng.choice([0.9, 1.0, 1.1])
            x += SHIFT * w * np.cos(angle) + w * (1 - factor) / 2
            y += SHIFT * h * np.sin(angle) + h * (1 - factor) / 2
            w, h = w * factor, h * factor
        runs.append(Run(str(key), int(later[0]), (float(x), float(y), float(w), float(h))))
    return runs


def record(source: str, sequence: Sequence, config: MFCMTConfig) -> Recorded:
    """Run the tracker from :func:`starts`; decode every frame once."""
    runs = starts(sequence)
    trackers: dict[str, _Recorder] = {}
    rows: list[tuple[float, ...]] = []
    found: list[tuple[float, ...]] = []
    boxes: list[tuple[float, ...]] = []
    frames: list[int] = []
    status: list[int] = []
    for index in range(min(run.start for run in runs), len(sequence)):
        image: Image = sequence.read(index)
        for run in runs:
            if index == run.start:
                trackers[run.key] = _Recorder(config)
                trackers[run.key].init(image, run.box)
            if index <= run.start:
                continue
            tracker = trackers[run.key]
            result = tracker.update(image)
            judge = tracker._require_target().confidence
            rows.append(tuple(judge.signals[index] for index in WEIGHED))
            _, _, w, h = result.box
            boxes.append(result.box)
            lost = result.status == "lost"
            found.append((tracker.found[0] - w / 2, tracker.found[1] - h / 2, w, h) if lost else result.box)
            frames.append(index)
            status.append(STATUSES.index(result.status))
    truth, valid = sequence.boxes[frames], sequence.valid[frames]
    return Recorded(
        source,
        sequence.name,
        np.array(rows),
        np.where(valid, overlap(np.array(found), truth), np.nan),
        np.where(valid, overlap(np.array(boxes), truth), np.nan),
        np.array(status, np.float64),
    )


def record_all(
    datasets: Seq[Dataset], config: MFCMTConfig, jobs: int | None, backend: str = LOCAL
) -> Iterator[Recorded]:
    """Yield :func:`record` of every sequence, as each is done; the longest comes first. Raises DataError."""
    work = [(s.source or d.name, s, config) for d in datasets for s in d]
    work.sort(key=lambda job: -len(job[1]))
    for job, recorded in run_batch(_record, work, jobs, backend):
        if isinstance(recorded, Lost):
            raise DataError(f"{job[1].name}: {recorded.reason}")
        yield recorded


def _record(job: tuple[str, Sequence, MFCMTConfig]) -> Recorded:
    return record(*job)


@dataclass(frozen=True, eq=False)
class Fit:
    """Weights (S,) of the raw signals and the bias of a logistic regression."""

    weights: Array
    bias: float

    def confidence(self, signals: Array) -> Array:
        """Return the probability that each box is right, (N,)."""
        score = np.clip(signals @ self.weights + self.bias, -30, 30)
        return np.asarray(1 / (1 + np.exp(-score)))


def fit(recorded: Seq[Recorded], ridge: float = RIDGE) -> Fit:
    """Fit a logistic regression of right against other frames; frames without a target are not right."""
    signals = np.concatenate([r.signals for r in recorded])
    right = np.concatenate([np.nan_to_num(r.overlap) > RIGHT for r in recorded]).astype(float)
    weight = np.concatenate([np.full(len(r.overlap), 1 / len(r.overlap)) for r in recorded])
    weight /= weight.sum()
    mean, deviation = signals.mean(axis=0), signals.std(axis=0) + 1e-6
    columns = np.column_stack([(signals - mean) / deviation, np.ones(len(signals))])
    penalty = np.diag([ridge] * signals.shape[1] + [0.0])
    solution = np.zeros(columns.shape[1])
    for _ in range(STEPS):
        p = 1 / (1 + np.exp(-np.clip(columns @ solution, -30, 30)))
        gradient = columns.T @ (weight * (p - right)) + penalty @ solution
        curvature = (columns * (weight * p * (1 - p))[:, None]).T @ columns + penalty
        step = np.linalg.solve(curvature, gradient)
        solution -= step
        if np.abs(step).max() < 1e-9:
            break
    weights = solution[:-1] / deviation
    return Fit(weights, float(solution[-1] - weights @ mean))


def held_out(recorded: Seq[Recorded], ridge: float = RIDGE) -> list[Judged]:
    """Return every sequence, judged by a fit without its data set; the status is that of the run."""
    judged = []
    for source in sorted({r.source for r in recorded}):
        model = fit([r for r in recorded if r.source != source], ridge)
        judged += [
            Judged(r.name, r.overlap, model.confidence(r.signals), r.status) for r in recorded if r.source == source
        ]
    return judged


def constants(model: Fit) -> str:
    """Return the fit as the text that goes into :mod:`mfcmt_core.confidence`."""
    rows = "".join(f'        "{name}": {w:.4f},\n' for name, w in zip(DEFAULT.weights, model.weights, strict=True))
    return f"Model(\n    bias={model.bias:.4f},\n    weights={{\n{rows}    }},\n)"
