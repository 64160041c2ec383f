"""Run trackers over a data set under a protocol and score them; go on where an earlier run stopped."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..errors import DataError
from .batch import LOCAL, Lost, run_batch
from .dataset import Dataset, Sequence
from .jobs import Job, Outcome, one_thread, plan, run_job
from .metrics import Array, overlap
from .protocol import PROTOCOLS, Run
from .results import Record, ResultStore, read_result, read_trust
from .score import Evaluation, score_runs
from .trackers import Entry, ResultFolder, identity_hash
from .trust import Judged

Progress = Callable[[int, int], None]

CLUSTER = 16
"""How many processes a cluster is taken to have where runs are cut into jobs."""


def evaluate(
    dataset: Dataset,
    trackers: Iterable[Entry | ResultFolder],
    protocol: str = "OPE",
    *,
    results: Path | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
    backend: str = LOCAL,
) -> list[Evaluation]:
    """Score each tracker over the data set under ``OPE``, ``TRE`` or ``SRE``.

    Parameters
    ----------
    dataset : Dataset
        The sequences with their truth.
    trackers : iterable of Entry or ResultFolder
        Trackers to run, and folders of results to score; each needs a name of its own.
    protocol : str, optional
        A name of :data:`PROTOCOLS`.
    results : Path, optional
        The folder of result files. A run that is finished there with the same code and configuration is not run
        again. Without it, the results are discarded after the scoring.
    jobs : int, optional
        The number of processes, by default one a CPU. With 1 the trackers run in this process; with more, a script
        needs its ``if __name__ == "__main__"``.
    progress : callable, optional
        Called with the steps done and the number of all steps as each job is done; a step is one frame of one run.
    backend : str, optional
        Where the processes are: one of :data:`~.batch.BACKENDS`.

    Returns
    -------
    list of Evaluation
        One for each tracker, in their order. A sequence on which a tracker raised is named, with the reason, in its
        :attr:`Evaluation.missing`.

    Raises
    ------
    DataError
        Two trackers have the same name, or there is no cluster for the backend.
    """
    trackers = list(trackers)
    if len({t.name for t in trackers}) < len(trackers):
        raise DataError("two trackers have the same name: " + ", ".join(sorted(t.name for t in trackers)))
    runs = {sequence.name: PROTOCOLS[protocol](sequence) for sequence in dataset}
    with ExitStack() as stack:
        root = results or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mfcmt-eval-")))
        store = ResultStore(root)
        entries = [t for t in trackers if not isinstance(t, ResultFolder)]
        _run(dataset, entries, protocol, runs, store, progress, jobs, backend)
        return [_scored(dataset, result_folder(t, protocol, root), protocol, runs) for t in trackers]


def result_folder(tracker: Entry | ResultFolder, protocol: str, results: Path) -> ResultFolder:
    """Return the folder of a tracker's files."""
    if isinstance(tracker, ResultFolder):
        return tracker.under(protocol)
    return ResultFolder(tracker.name, ResultStore(results).folder(protocol, tracker.name))


def _run(
    dataset: Dataset,
    entries: list[Entry],
    protocol: str,
    runs: dict[str, list[Run]],
    store: ResultStore,
    progress: Progress | None,
    workers: int | None,
    backend: str,
) -> None:
    """Do the runs that are not finished, and keep each as soon as it is."""
    records: dict[tuple[str, str], Record] = {}
    pairs: list[tuple[Entry, Sequence, list[Run]]] = []
    for entry in entries:
        made_with = entry.identity
        identity = identity_hash(made_with)
        for sequence in dataset:
            record = store.record(protocol, entry.name, sequence.name)
            if record is None or record.identity != identity or record.error is not None:
                record = Record(identity, made_with)
            todo = [
                run
                for run in runs[sequence.name]
                if not record.has(run, len(sequence) - run.start)
                or not store.boxes_path(protocol, entry.name, sequence.name, run.key).is_file()
            ]
            if todo and not sequence.frames:
                raise DataError(f"{dataset.root}: {sequence.name} has no images for {entry.name} to run on")
            if todo:
                records[entry.name, sequence.name] = record
                pairs.append((entry, sequence, todo))

    if backend == LOCAL:
        workers = workers or os.cpu_count() or 1
    jobs = plan(pairs, workers or CLUSTER)
    total = sum(job.steps for job in jobs)
    done = 0
    here = workers == 1 and backend == LOCAL
    for job, outcome in _here(jobs) if here else run_batch(run_job, jobs, workers, backend):
        if isinstance(outcome, Lost):
            outcome = Outcome(error=f"{job.sequence.name}: {outcome.reason}")
        done += job.steps
        if progress is not None:
            progress(done, total)
        record = records[job.entry.name, job.sequence.name]
        record.error = outcome.error or record.error
        for run in job.runs:
            if run.key in outcome.speeds:
                speed = asdict(outcome.speeds[run.key])
                asked = run.key in outcome.trust
                record.runs[run.key] = {"start": run.start, "box": list(run.box), "trust": asked, **speed}
        store.write(protocol, job.entry.name, job.sequence.name, record, outcome.boxes, outcome.trust)


def _here(jobs: list[Job]) -> Iterator[tuple[Job, Outcome]]:
    """Do the jobs in this process."""
    for job in jobs:
        with one_thread():
            outcome = run_job(job)
        yield job, outcome


def _scored(dataset: Dataset, folder: ResultFolder, protocol: str, runs: dict[str, list[Run]]) -> Evaluation:
    evaluation = Evaluation(folder.name, protocol, {}, {})
    for sequence in dataset:
        try:
            record = folder.record(sequence.name)
            if record is not None and record.error is not None:
                raise DataError(record.error)
            boxes = [
                (run, read_result(folder.find(sequence.name, run.key), sequence, run.start))
                for run in runs[sequence.name]
            ]
            evaluation.scores[sequence.name] = score_runs(sequence, boxes, folder.speed(sequence.name))
        except DataError as absent:
            evaluation.missing[sequence.name] = str(absent)
    return evaluation


def judged(tracker: Entry | ResultFolder, dataset: Dataset, protocol: str, results: Path) -> list[Judged]:
    """Return what a tracker said of its finished runs, by sequence; without the first frames, whose boxes are given.

    Sequences for which it said nothing are left out. Frames without a usable annotation count as absent where the
    data set leaves them out of its scores, and not at all elsewhere.
    """
    folder = result_folder(tracker, protocol, results)
    found = []
    for sequence in dataset:
        parts = []
        for run in PROTOCOLS[protocol](sequence):
            try:
                path = folder.find(sequence.name, run.key)
                said = read_trust(path, len(sequence) - run.start)
            except DataError:
                continue
            if said is None:
                continue
            boxes, valid = read_result(path, sequence, run.start), sequence.valid[run.start :]
            overlaps = np.where(valid, overlap(boxes, sequence.boxes[run.start :]), np.nan)
            rows = np.column_stack([overlaps, said])[1:]
            parts.append(rows if sequence.skip_invalid else rows[valid[1:]])
        if parts and sum(map(len, parts)):
            rows = np.concatenate(parts)
            found.append(Judged(sequence.name, rows[:, 0], rows[:, 1], rows[:, 2]))
    return found


def boxes_of(tracker: Entry | ResultFolder, sequence: Sequence, results: Path) -> Array:
    """Return the boxes of a finished OPE run, ``(N, 4)``, 0-based. Raises DataError if there are none."""
    run = PROTOCOLS["OPE"](sequence)[0]
    path = result_folder(tracker, "OPE", results).find(sequence.name, run.key)
    return read_result(path, sequence, run.start)
