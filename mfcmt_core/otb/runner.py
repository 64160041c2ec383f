"""Run trackers over a data set under a protocol and score them; go on where an earlier run stopped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path

from .dataset import Dataset, Sequence
from .errors import DataError
from .metrics import Array
from .pool import Outcome, plan, run_jobs
from .protocol import PROTOCOLS, Run
from .results import Record, ResultStore, read_result, rounded
from .score import Evaluation, Speed, score_runs
from .trackers import Entry, ResultFolder, identity_hash

Progress = Callable[[int, int], None]
Boxes = dict[tuple[str, str], dict[str, Array]]
Records = dict[tuple[str, str], Record]


def evaluate(
    dataset: Dataset,
    trackers: Iterable[Entry | ResultFolder],
    protocol: str = "OPE",
    *,
    results: Path | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> list[Evaluation]:
    """Score each tracker over the data set under ``OPE``, ``TRE`` or ``SRE``.

    ``results`` is the folder of result files: what is finished there with the same code and configuration is
    not run again. ``jobs`` is the number of processes (default: one a CPU). 1 stays in this one; with more a
    script needs its ``if __name__ == "__main__"``. ``progress`` gets the steps done and all steps.
    A tracker that raises loses the sequence, which is then named in :attr:`Evaluation.missing`.
    """
    trackers = list(trackers)
    if len({t.name for t in trackers}) < len(trackers):
        raise DataError("two trackers have the same name: " + ", ".join(sorted(t.name for t in trackers)))
    runs = {sequence.name: PROTOCOLS[protocol](sequence) for sequence in dataset}
    entries = [t for t in trackers if not isinstance(t, ResultFolder)]
    store = ResultStore(results) if results is not None else None
    records, fresh = _run(dataset, entries, protocol, runs, store, jobs or os.cpu_count() or 1, progress)
    evaluations = []
    for tracker in trackers:
        evaluation = Evaluation(tracker.name, protocol, {}, {})
        for sequence in dataset:
            try:
                if isinstance(tracker, ResultFolder):
                    boxes, speed = _published(tracker, sequence, runs[sequence.name])
                else:
                    pair = tracker.name, sequence.name
                    record = records[pair]
                    if record.error is not None:
                        raise DataError(record.error)
                    boxes = _collected(
                        store, protocol, pair, sequence, runs[sequence.name], fresh.get(pair, {})
                    )
                    speed = _speed(record)
                evaluation.scores[sequence.name] = score_runs(sequence, boxes, speed)
            except DataError as absent:
                evaluation.missing[sequence.name] = str(absent)
        evaluations.append(evaluation)
    return evaluations


def _run(
    dataset: Dataset,
    entries: list[Entry],
    protocol: str,
    runs: dict[str, list[Run]],
    store: ResultStore | None,
    workers: int,
    progress: Progress | None,
) -> tuple[Records, Boxes]:
    records: Records = {}
    pairs: list[tuple[Entry, Sequence, list[Run]]] = []
    for entry in entries:
        made_with = entry.identity
        identity = identity_hash(made_with)
        for sequence in dataset:
            record = store.record(protocol, entry.name, sequence.name) if store else None
            if record is None or record.identity != identity or record.error is not None:
                record = Record(identity, made_with)
            records[entry.name, sequence.name] = record
            todo = [
                run
                for run in runs[sequence.name]
                if not _finished(record, run, sequence, store, protocol, entry)
            ]
            if todo and not sequence.frames:
                raise DataError(
                    f"{dataset.root}: {sequence.name} has no images, so {entry.name} cannot run on it"
                )
            if todo:
                pairs.append((entry, sequence, todo))

    jobs = plan(pairs, workers)
    total = sum(job.frames for job in jobs)
    done = 0

    def tick(steps: int) -> None:
        nonlocal done
        done += steps
        if progress is not None:
            progress(done, total)

    fresh: Boxes = {}
    for job, outcome in run_jobs(jobs, min(workers, len(jobs)), tick):
        pair = job.entry.name, job.sequence.name
        record = records[pair]
        new = {key: rounded(boxes) for key, boxes in outcome.boxes.items()}
        fresh.setdefault(pair, {}).update(new)
        _note(record, job.runs, outcome)
        if store is not None:
            store.write(protocol, *pair, record, new)
    return records, fresh


def _finished(
    record: Record, run: Run, sequence: Sequence, store: ResultStore | None, protocol: str, entry: Entry
) -> bool:
    return (
        store is not None
        and record.has(run, len(sequence) - run.start)
        and store.boxes_path(protocol, entry.name, sequence.name, run.key).is_file()
    )


def _note(record: Record, runs: Iterable[Run], outcome: Outcome) -> None:
    if outcome.error is not None:
        record.error = outcome.error
        return
    for run in runs:
        speed = outcome.speeds[run.key]
        record.runs[run.key] = {"start": run.start, "box": list(run.box), **asdict(speed)}


def _collected(
    store: ResultStore | None,
    protocol: str,
    pair: tuple[str, str],
    sequence: Sequence,
    runs: list[Run],
    fresh: dict[str, Array],
) -> list[tuple[Run, Array]]:
    boxes = []
    for run in runs:
        if run.key in fresh:
            boxes.append((run, fresh[run.key]))
        elif store is not None:
            boxes.append((run, read_result(store.boxes_path(protocol, *pair, run.key), sequence, run.start)))
        else:
            raise DataError(f"{sequence.name}: run {run.key} is not done")
    return boxes


def _speed(record: Record) -> Speed:
    runs = record.runs.values()
    frames = sum(run["frames"] for run in runs)
    rate = sum(run["mean_rate"] * run["frames"] for run in runs) / frames
    return Speed(frames, sum(run["seconds"] for run in runs), rate)


def _published(
    tracker: ResultFolder, sequence: Sequence, runs: list[Run]
) -> tuple[list[tuple[Run, Array]], Speed | None]:
    boxes = [(run, read_result(tracker.find(sequence.name, run.key), sequence, run.start)) for run in runs]
    return boxes, tracker.speed(sequence.name)
