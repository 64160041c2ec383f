"""Tools of the benchmarks: one core, one thread, processor time, and a clock for each stage of the tracker."""

from __future__ import annotations

import os
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import numpy.typing as npt

from .. import search, synthetic, tracker
from ..color import ColorModel
from ..features import FeatureStack
from ..geometry import Image, SearchWindow
from ..otb.dataset import Sequence
from ..otb.layouts import open_dataset
from ..otb.metrics import Array
from ..result import Box
from ..scale import ScaleModel
from ..template import TemplateModel

STAGES: tuple[tuple[str, Any, str], ...] = (
    ("search window", SearchWindow, "crop"),
    ("template features", FeatureStack, "extract"),
    ("template spectra", TemplateModel, "spectra"),
    ("colour bins", ColorModel, "bins"),
    ("template response", TemplateModel, "respond"),
    ("colour response", ColorModel, "respond"),
    ("fusion", search, "fuse"),
    ("scale features", ScaleModel, "spectra"),
    ("scale response", ScaleModel, "estimate"),
    ("template learning", TemplateModel, "learn"),
    ("colour learning", ColorModel, "learn"),
    ("scale learning", ScaleModel, "learn"),
    ("re-detection", search.Search, "_redetect"),
    ("everything else", tracker.MFCMT, "update"),
)
"""Name and function of each stage, in the order of Algorithm 1. Time in an inner stage counts only there."""


@dataclass(frozen=True, eq=False)
class Material:
    """A sequence with its frames decoded."""

    sequence: Sequence
    frames: list[Image]

    @property
    def name(self) -> str:
        return self.sequence.name

    @property
    def box(self) -> Box:
        """The target in the first frame."""
        x, y, w, h = (float(v) for v in self.sequence.boxes[0])
        return x, y, w, h


def synthetic_material(name: str, frames: int | None) -> Iterator[Material]:
    """Yield a rendered clip."""
    clip = synthetic.clip(name)
    known = np.ones(len(clip), bool)
    yield _decoded(Sequence(name, (), clip.boxes, known, known), clip.frames.__getitem__, frames)


def real_material(root: Path, names: str | None, frames: int | None) -> Iterator[Material]:
    """Yield the sequences of a folder, one after the other. Raises DataError."""
    dataset = open_dataset(root)
    for sequence in dataset.select(names.split(",")) if names else dataset:
        yield _decoded(sequence, sequence.read, frames)


def real_lengths(root: Path, names: str | None) -> list[int]:
    """Return how many frames each sequence of :func:`real_material` has. Raises DataError."""
    dataset = open_dataset(root)
    return [len(sequence) for sequence in (dataset.select(names.split(",")) if names else dataset)]


def _decoded(sequence: Sequence, read: Callable[[int], Image], frames: int | None) -> Material:
    count = min(frames or len(sequence), len(sequence))
    first = {name: getattr(sequence, name)[:count] for name in ("frames", "boxes", "valid", "startable")}
    return Material(replace(sequence, **first), [read(i) for i in range(count)])


def pin(core: int | None) -> str:
    """Restrict this process to one core and one thread, and return a description of the machine."""
    cv2.setNumThreads(1)
    where = "one thread"
    if hasattr(os, "sched_setaffinity"):
        chosen = max(os.sched_getaffinity(0)) if core is None else core
        os.sched_setaffinity(0, {chosen})
        where = f"core {chosen}, one thread"
    versions = f"numpy {np.__version__}, numba {numba.__version__}, OpenCV {cv2.__version__}"
    return f"{cpu_name()}, {where}; Python {platform.python_version()}, {versions}"


def cpu_name() -> str:
    """Return the processor's model name."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8", errors="replace").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith(("model name", "Model"))]
    return names[0] if names else platform.processor() or platform.machine()


@dataclass(frozen=True, eq=False)
class Timed:
    """A timed run. For each update: processor seconds, wall seconds, box, and the state of the tracker.

    ``alive`` is False if a peer reported that it had lost the target. ``lost`` is True if ours reported ``"lost"``.
    """

    cpu: Array
    wall: Array
    boxes: Array
    alive: npt.NDArray[np.bool_]
    lost: npt.NDArray[np.bool_]


def warm_up(tracker: Any, material: Material) -> None:
    """Track three frames, so that everything that is loaded or allocated on first use is there."""
    tracker.init(material.frames[0], material.box)
    for frame in material.frames[1:3]:
        tracker.update(frame)


def timed_run(tracker: Any, material: Material) -> Timed:
    """Track through the material. Row 0 is ``init``, with the given box.

    Processor time is the thread's: other processes on the core delay it, but do not count.
    """
    count = len(material.frames)
    cpu, wall, boxes, alive = np.empty(count), np.empty(count), np.empty((count, 4)), np.ones(count, bool)
    lost = np.zeros(count, bool)
    for i, frame in enumerate(material.frames):
        wall[i], cpu[i] = time.perf_counter(), time.thread_time()
        result = tracker.update(frame) if i else tracker.init(frame, material.box)
        cpu[i], wall[i] = time.thread_time() - cpu[i], time.perf_counter() - wall[i]
        boxes[i] = getattr(result, "box", result) if i else material.box
        alive[i] = getattr(tracker, "found", True)
        lost[i] = getattr(result, "status", "") == "lost"
    return Timed(cpu, wall, boxes, alive, lost)


def spread(seconds: Array) -> float | None:
    """Return the 99th percentile over the median, or None for no values."""
    return float(np.percentile(seconds, 99) / np.median(seconds)) if len(seconds) else None


class StageClock:
    """Measures the processor time of each stage. ``seconds[name]`` and ``calls[name]`` have a value per frame."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, list[float]] = defaultdict(list)
        self.calls: defaultdict[str, list[int]] = defaultdict(list)
        self._frame: dict[str, tuple[float, int]] = {}
        self._inner: list[float] = []

    @contextmanager
    def running(self) -> Iterator[None]:
        """Wrap the functions of all stages within the block."""
        with ExitStack() as stack:
            for name, owner, attribute in STAGES:
                original = getattr(owner, attribute)
                setattr(owner, attribute, self._clocked(name, original))
                stack.callback(setattr, owner, attribute, original)
            yield

    def end_frame(self) -> None:
        """Record the times since the last call as one frame."""
        for name, _, _ in STAGES:
            seconds, calls = self._frame.get(name, (0.0, 0))
            self.seconds[name].append(seconds)
            self.calls[name].append(calls)
        self._frame.clear()

    def _clocked(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def clocked(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            start = time.thread_time()
            try:
                return function(*args, **kwargs)
            finally:
                took = time.thread_time() - start
                seconds, calls = self._frame.get(name, (0.0, 0))
                self._frame[name] = seconds + took - self._inner.pop(), calls + 1
                if self._inner:
                    self._inner[-1] += took

        return clocked
