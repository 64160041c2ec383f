"""The work of an evaluation, cut into jobs: runs of one tracker on one sequence."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from collections.abc import Sequence as Seq
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from .dataset import Image, Sequence
from .metrics import Array
from .protocol import Run
from .score import Speed
from .trackers import Entry, Tracker, said

KEPT_BYTES = 128 * 2**20
"""Decoded frames that a process keeps for the next tracker on the same sequence.

joblib has no such bound: what its processes keep is theirs. It starts one anew that has grown by 300 MB.
"""


@dataclass(frozen=True, eq=False)
class Job:
    """Runs of one tracker on one sequence, done in step so that each frame is decoded once."""

    entry: Entry
    sequence: Sequence
    runs: tuple[Run, ...]
    keep_frames: bool = False

    @property
    def steps(self) -> int:
        """Return the number of tracker steps."""
        return sum(len(self.sequence) - run.start for run in self.runs)


@dataclass
class Outcome:
    """Boxes ``(N, 4)`` 0-based and speed by run key, or the error that stopped the tracker.

    ``trust`` has ``(N, 2)`` by run key of trackers that say how sure they are: confidence and index of the status.
    """

    boxes: dict[str, Array] = field(default_factory=dict)
    trust: dict[str, Array] = field(default_factory=dict)
    speeds: dict[str, Speed] = field(default_factory=dict)
    error: str | None = None


class _Frames(threading.local):
    """The frames of one sequence, as far as they may be kept for the next job of this thread."""

    def __init__(self) -> None:
        self._owner: tuple[object, ...] = ()
        self._kept: dict[int, Image] = {}
        self._kept_bytes = 0

    def read(self, job: Job, index: int) -> Image:
        if self._owner != job.sequence.frames:
            self._owner, self._kept, self._kept_bytes = job.sequence.frames, {}, 0
        image = self._kept.get(index)
        if image is None:
            image = job.sequence.read(index)
            if job.keep_frames and self._kept_bytes + image.nbytes <= KEPT_BYTES:
                self._kept[index] = image
                self._kept_bytes += image.nbytes
        return image


_frames = _Frames()


def run_job(job: Job) -> Outcome:
    """Do the runs in step, so that each frame is decoded once. What a tracker raises is in the outcome."""
    sequence = job.sequence
    boxes = {run.key: np.full((len(sequence) - run.start, 4), np.nan) for run in job.runs}
    trust = {run.key: np.full((len(sequence) - run.start, 2), np.nan) for run in job.runs}
    seconds = {key: np.zeros(len(rows)) for key, rows in boxes.items()}
    cpu_seconds = dict.fromkeys(boxes, 0.0)
    trackers: dict[str, Tracker] = {}
    index = 0
    try:
        for index in range(min(run.start for run in job.runs), len(sequence)):
            image = _frames.read(job, index)
            for run in job.runs:
                step = index - run.start
                if step < 0:
                    continue
                if step == 0 and not trackers:
                    _warm_up(job, image, run)
                begun, cpu_begun = time.perf_counter(), time.process_time()
                if step == 0:
                    trackers[run.key] = job.entry.make()
                    trackers[run.key].init(image, run.box)
                    box = run.box
                else:
                    result = trackers[run.key].update(image)
                    box = getattr(result, "box", result)
                seconds[run.key][step] = time.perf_counter() - begun
                cpu_seconds[run.key] += time.process_time() - cpu_begun
                boxes[run.key][step] = box
                if step:
                    trust[run.key][step] = said(result, trackers[run.key])
    except Exception as failed:
        return Outcome(error=f"{sequence.name}, frame {sequence.first + index}: {type(failed).__name__}: {failed}")
    speeds = {
        key: Speed(len(t), float(t.sum()), float(np.mean(1.0 / np.maximum(t, 1e-9))), cpu_seconds[key])
        for key, t in seconds.items()
    }
    told = {key: rows for key, rows in trust.items() if np.isfinite(rows[1:, 0]).all() and len(rows) > 1}
    return Outcome(boxes, told, speeds)


def _warm_up(job: Job, image: Image, run: Run) -> None:
    """Compile and load what the tracker needs on such frames, so that no frame is timed with it."""
    with suppress(Exception):  # what is wrong shows in the run itself
        tracker = job.entry.make()
        tracker.init(image, run.box)
        tracker.update(image)
        tracker.update(image)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let OpenCV use one thread in the block, as the processes of a batch do."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def plan(pairs: Seq[tuple[Entry, Sequence, Seq[Run]]], workers: int) -> list[Job]:
    """Return jobs for these pairs, the longest sequences first, a sequence's trackers next to each other.

    If there are fewer pairs than keep the processes busy, the runs of a pair become several jobs.
    """
    parts = -(-2 * workers // max(len(pairs), 1)) if workers > 1 else 1
    jobs = [
        Job(entry, sequence, tuple(runs[part::parts]))
        for entry, sequence, runs in pairs
        for part in range(min(parts, len(runs)))
    ]
    longest: dict[str, int] = {}
    for job in jobs:
        longest[job.sequence.name] = max(longest.get(job.sequence.name, 0), job.steps)
    jobs.sort(key=lambda job: (-longest[job.sequence.name], job.sequence.name))
    following = [*(job.sequence for job in jobs[1:]), None]
    return [replace(job, keep_frames=job.sequence is after) for job, after in zip(jobs, following, strict=False)]
