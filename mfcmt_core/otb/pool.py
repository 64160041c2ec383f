"""Processes that run trackers over sequences. One that dies loses its job, not the evaluation."""

from __future__ import annotations

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Sequence as Seq
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection

import cv2
import numpy as np

from .dataset import Image, Sequence
from .metrics import Array
from .protocol import Run
from .score import Speed
from .trackers import Entry, Tracker, said

KEPT_BYTES = 256 * 2**20
"""Decoded frames that a process keeps for the next tracker on the same sequence."""

TICK_FRAMES = 200

Tick = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Job:
    """Runs of one tracker on one sequence, done in step so that each frame is decoded once."""

    entry: Entry
    sequence: Sequence
    runs: tuple[Run, ...]
    keep_frames: bool = False

    @property
    def frames(self) -> int:
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


def run_jobs(jobs: Iterable[Job], workers: int, tick: Tick) -> Iterator[tuple[Job, Outcome]]:
    """Do the jobs, in this process when ``workers`` is 1, and yield each as it is done.

    ``tick`` is called with the number of tracker steps as they are made. Closing the generator stops the processes.
    """
    if workers > 1:
        yield from _in_processes(deque(jobs), workers, tick)
        return
    runner = _Runner(tick)
    for job in jobs:
        with _one_thread():
            outcome = runner.run(job)
        yield job, outcome


class _Runner:
    """Runs jobs; keeps the frames of the last sequence where the next job may want them."""

    def __init__(self, tick: Tick) -> None:
        self._tick = tick
        self._owner: tuple[object, ...] = ()
        self._kept: dict[int, Image] = {}
        self._kept_bytes = 0

    def run(self, job: Job) -> Outcome:
        sequence = job.sequence
        boxes = {run.key: np.full((len(sequence) - run.start, 4), np.nan) for run in job.runs}
        trust = {run.key: np.full((len(sequence) - run.start, 2), np.nan) for run in job.runs}
        seconds = {key: np.zeros(len(rows)) for key, rows in boxes.items()}
        cpu_seconds = dict.fromkeys(boxes, 0.0)
        trackers: dict[str, Tracker] = {}
        unticked = 0
        index = 0
        try:
            for index in range(min(run.start for run in job.runs), len(sequence)):
                image = self._read(job, index)
                for run in job.runs:
                    step = index - run.start
                    if step < 0:
                        continue
                    if step == 0 and not trackers:
                        self._warm_up(job, image, run)
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
                    unticked += 1
                if unticked >= TICK_FRAMES:
                    self._tick(unticked)
                    unticked = 0
        except Exception as failed:
            return Outcome(error=f"{sequence.name}, frame {sequence.first + index}: {type(failed).__name__}: {failed}")
        self._tick(unticked)
        speeds = {
            key: Speed(len(t), float(t.sum()), float(np.mean(1.0 / np.maximum(t, 1e-9))), cpu_seconds[key])
            for key, t in seconds.items()
        }
        told = {key: rows for key, rows in trust.items() if np.isfinite(rows[1:, 0]).all() and len(rows) > 1}
        return Outcome(boxes, told, speeds)

    def _warm_up(self, job: Job, image: Image, run: Run) -> None:
        """Compile and load what the tracker needs on such frames, so that no frame is timed with it."""
        with suppress(Exception):  # what is wrong shows in the run itself
            tracker = job.entry.make()
            tracker.init(image, run.box)
            tracker.update(image)
            tracker.update(image)

    def _read(self, job: Job, index: int) -> Image:
        if self._owner != job.sequence.frames:
            self._owner, self._kept, self._kept_bytes = job.sequence.frames, {}, 0
        image = self._kept.get(index)
        if image is None:
            image = job.sequence.read(index)
            if job.keep_frames and self._kept_bytes + image.nbytes <= KEPT_BYTES:
                self._kept[index] = image
                self._kept_bytes += image.nbytes
        return image


class _Worker:
    """A process, the pipe to it and the job it has."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self.pipe, far_end = context.Pipe()
        self.process = context.Process(target=_serve, args=(far_end,), daemon=True)
        with _one_thread_environment(), _no_interrupt():
            self.process.start()
        far_end.close()
        self.job: Job | None = None

    def give(self, job: Job) -> None:
        self.job = job
        self.pipe.send(job)

    def stop(self) -> None:
        self.process.terminate()
        self.process.join()
        self.pipe.close()


def _in_processes(queue: deque[Job], workers: int, tick: Tick) -> Iterator[tuple[Job, Outcome]]:
    team: dict[Connection, _Worker] = {}
    try:
        while queue or team:
            while queue and len(team) < workers:
                worker = _Worker()
                team[worker.pipe] = worker
                worker.give(queue.popleft())
            for pipe in connection.wait(list(team)):
                assert isinstance(pipe, Connection)
                worker = team[pipe]
                job = worker.job
                assert job is not None
                try:
                    message = pipe.recv()
                except (EOFError, ConnectionError):
                    worker.stop()
                    del team[pipe]
                    message = Outcome(error=f"{job.sequence.name}: the process died ({worker.process.exitcode})")
                if isinstance(message, int):
                    tick(message)
                    continue
                if pipe in team:
                    if queue:
                        worker.give(queue.popleft())
                    else:
                        worker.stop()
                        del team[pipe]
                yield job, message
    finally:
        for worker in team.values():
            worker.stop()


def _serve(pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    runner = _Runner(pipe.send)
    while True:
        try:
            pipe.send(runner.run(pipe.recv()))
        except (EOFError, ConnectionError):
            return


@contextmanager
def _one_thread() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Let processes that start in this block ignore Ctrl-C: the parent hears it and stops them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def _one_thread_environment() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def plan(pairs: Seq[tuple[Entry, Sequence, Seq[Run]]], workers: int) -> list[Job]:
    """Return jobs for these pairs, the longest sequences first, a sequence's trackers next to each other.

    If there are fewer pairs than keep the processes busy, the runs of a pair become several jobs.
    """
    parts = -(-2 * workers // max(len(pairs), 1)) if workers > 1 else 1
    several = len({entry.name for entry, _, _ in pairs}) > 1
    jobs = [
        Job(entry, sequence, tuple(runs[part::parts]), keep_frames=several)
        for entry, sequence, runs in pairs
        for part in range(min(parts, len(runs)))
    ]
    longest: dict[str, int] = {}
    for job in jobs:
        longest[job.sequence.name] = max(longest.get(job.sequence.name, 0), job.frames)
    return sorted(jobs, key=lambda job: (-longest[job.sequence.name], job.sequence.name))
