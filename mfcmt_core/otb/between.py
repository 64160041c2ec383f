"""How good boxes between keyframes are: tracked from both ends, forward alone, or on lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..config import MFCMTConfig
from ..errors import DataError
from ..interpolate import interpolate
from ..tracker import MFCMT
from .batch import LOCAL, Lost, run_batch
from .dataset import Dataset, Sequence
from .document import Table
from .metrics import Array, overlap

WAYS = ("lines between them", "tracked forward", "tracked from both ends")

Scores = dict[int, dict[str, list[Array]]]
"""Overlaps of the frames between keyframes: by distance, by way, a sequence each."""


@dataclass(frozen=True, eq=False)
class _Job:
    sequence: Sequence
    distance: int
    config: MFCMTConfig


def between_keyframes(
    dataset: Dataset,
    distances: list[int],
    config: MFCMTConfig,
    jobs: int | None,
    progress: Callable[[int, int], None],
    backend: str = LOCAL,
) -> Scores:
    """Return the overlaps with the truth in each frame between keyframes that are ``distances`` frames apart.

    A keyframe without a usable annotation moves to the next frame that has one. Raises DataError.
    """
    work = [_Job(sequence, distance, config) for distance in distances for sequence in dataset]
    found: dict[_Job, dict[str, Array]] = {}
    for job, overlaps in run_batch(_measure, work, jobs, backend):
        if isinstance(overlaps, Lost):
            raise DataError(f"{job.sequence.name}: {overlaps.reason}")
        found[job] = overlaps
        progress(len(found), len(work))
    scores: Scores = {distance: {way: [] for way in WAYS} for distance in distances}
    for job in work:
        for way, of_way in found[job].items():
            scores[job.distance][way].append(of_way)
    return scores


def between_table(scores: Scores) -> Table:
    """Return mean overlap and the share of frames above one half, each sequence with the same weight."""
    rows = []
    for distance, ways in scores.items():
        for way, overlaps in ways.items():
            if not overlaps:
                continue
            means = [np.mean([value(o) for o in overlaps]) for value in (np.mean, lambda o: np.mean(o > 0.5))]
            rows.append([str(distance), way, *(f"{mean:.3f}" for mean in means), str(sum(map(len, overlaps)))])
    return Table(("a keyframe every", "boxes", "mean overlap", "above one half", "frames"), rows)


def keyframes(sequence: Sequence, distance: int) -> list[int]:
    """Return frames with a usable annotation, ``distance`` or more apart, from the first one on."""
    found: list[int] = []
    for index in np.flatnonzero(sequence.valid):
        if not found or index >= found[-1] + distance:
            found.append(int(index))
    return found


def _measure(job: _Job) -> dict[str, Array]:
    sequence = job.sequence
    keys = keyframes(sequence, job.distance)
    if len(keys) < 2:
        return {}
    known = {key: sequence.boxes[key] for key in keys}
    span = range(keys[0], keys[-1] + 1)
    both = {keys[0] + f.frame: f.result.box for f in interpolate(_images(sequence, span), _moved(known), job.config)}
    boxes = {
        "lines between them": np.column_stack([np.interp(span, keys, [known[k][i] for k in keys]) for i in range(4)]),
        "tracked forward": np.array(list(_forward(sequence, span, known, job.config))),
        "tracked from both ends": np.array([both[index] for index in span]),
    }
    scored = np.array([sequence.valid[index] and index not in known for index in span])
    return {way: overlap(found[scored], sequence.boxes[span.start : span.stop][scored]) for way, found in boxes.items()}


def _moved(known: dict[int, Array]) -> dict[int, Array]:
    first = min(known)
    return {key - first: box for key, box in known.items()}


def _images(sequence: Sequence, span: range) -> Iterator[np.ndarray]:
    return (sequence.read(index) for index in span)


def _forward(
    sequence: Sequence, span: range, known: dict[int, Array], config: MFCMTConfig
) -> Iterator[tuple[float, ...]]:
    tracker = MFCMT(config)
    for index in span:
        image = sequence.read(index)
        yield (tracker.init(image, known[index]) if index in known else tracker.update(image)).box
