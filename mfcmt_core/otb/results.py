"""Result files: boxes as OTB text, one file a run, and beside them what they were made with.

``<root>/OPE/<tracker>/<Sequence>.txt`` holds ``x,y,w,h`` a frame, 1-based, three decimals, as the toolkit and
got10k read it; runs of TRE and SRE carry their key: ``David.07.txt``, ``David.topLeft.txt``. ``David.trust.csv``
beside it holds ``confidence,status`` a frame, where the tracker says so.
``<Sequence>.json`` tells code, configuration, start and time of each run: what is named there is finished.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from .dataset import ONE_BASED, Sequence, read_boxes
from .metrics import Array
from .protocol import Run
from .score import Speed
from .trust import STATUSES

TRUST_SUFFIX = ".trust.csv"


@dataclass
class Record:
    """The finished runs of a tracker on a sequence by key, or why there are none. ``identity`` is a hash."""

    identity: str
    made_with: dict[str, Any]
    runs: dict[str, dict[str, Any]] = field(default_factory=dict)
    error: str | None = None

    def has(self, run: Run, frames: int) -> bool:
        """Return whether this very run is finished."""
        wanted = {"start": run.start, "box": list(run.box), "frames": frames}
        made = self.runs.get(run.key, {})
        return "trust" in made and wanted.items() <= made.items()  # older ones did not keep what the tracker said

    @property
    def speed(self) -> Speed | None:
        """Return the speed of all runs together; None if nothing is finished."""
        frames = sum(run["frames"] for run in self.runs.values())
        if not frames:
            return None
        rate = sum(run["mean_rate"] * run["frames"] for run in self.runs.values()) / frames
        cpu_seconds = sum(run.get("cpu_seconds", 0.0) for run in self.runs.values())
        return Speed(frames, sum(run["seconds"] for run in self.runs.values()), rate, cpu_seconds)


def read_record(path: Path) -> Record | None:
    """Return the record in a file; None if there is none that can be read."""
    try:
        return Record(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


@dataclass(frozen=True)
class ResultStore:
    """The result files under ``root``."""

    root: Path

    def folder(self, protocol: str, tracker: str) -> Path:
        return self.root / protocol / tracker

    def boxes_path(self, protocol: str, tracker: str, sequence: str, key: str) -> Path:
        return self.folder(protocol, tracker) / (f"{sequence}.{key}.txt" if key else f"{sequence}.txt")

    def record(self, protocol: str, tracker: str, sequence: str) -> Record | None:
        """Return the record of this tracker on this sequence; None if there is none."""
        return read_record(self.folder(protocol, tracker) / f"{sequence}.json")

    def write(
        self,
        protocol: str,
        tracker: str,
        sequence: str,
        record: Record,
        boxes: dict[str, Array],
        trust: dict[str, Array],
    ) -> None:
        """Write new boxes by run key (0-based), then the record: after a crash in between, the runs are unfinished."""
        folder = self.folder(protocol, tracker)
        folder.mkdir(parents=True, exist_ok=True)
        for key, values in boxes.items():
            path = self.boxes_path(protocol, tracker, sequence, key)
            write_boxes(path, values)
            if key in trust:
                _write_trust(trust_path(path), trust[key])
        _replace(folder / f"{sequence}.json", json.dumps(vars(record), indent=1) + "\n")


def write_boxes(path: Path, boxes: Array) -> None:
    """Write 0-based boxes ``(N, 4)`` as OTB text: 1-based, three decimals, a line a frame."""
    rows = boxes + ONE_BASED
    _replace(path, "".join("{:.3f},{:.3f},{:.3f},{:.3f}\n".format(*row) for row in rows))


def trust_path(boxes: Path) -> Path:
    """Return the file beside a file of boxes that holds a line ``confidence,status`` a frame."""
    return boxes.with_name(boxes.stem + TRUST_SUFFIX)


def _write_trust(path: Path, rows: Array) -> None:
    names = [STATUSES[int(s)] if np.isfinite(s) else "" for s in rows[:, 1]]
    _replace(path, "".join(f"{c:.6g},{name}\n" for c, name in zip(rows[:, 0], names, strict=True)))


def read_trust(boxes: Path, frames: int) -> Array | None:
    """Return confidence and index of the status, (N, 2), NaN for what is unknown; None if there is no such file.

    Raises DataError if the file has other lines, or not ``frames`` of them.
    """
    path = trust_path(boxes)
    if not path.is_file():
        return None
    try:
        lines = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
        rows = [(float(c), STATUSES.index(s) if s else float("nan")) for c, s in lines]
    except (OSError, ValueError) as failed:
        raise DataError(f"{path}: not lines of confidence,status: {failed}") from failed
    if len(rows) != frames:
        raise DataError(f"{path}: {len(rows)} lines for {frames} frames")
    return np.array(rows, np.float64)


def read_result(path: Path, sequence: Sequence, start: int = 0) -> Array:
    """Return the boxes of a run that began at index ``start`` of the sequence.

    A file longer than the sequence is cut: by frame number if it has a line for each frame from number 1 on, else
    at its end, as the toolkit does.

    Parameters
    ----------
    path : Path
        A file of 1-based boxes, a line a frame.
    sequence : Sequence
        The sequence on which the tracker ran.
    start : int, optional
        Index of the run's first frame in the sequence.

    Returns
    -------
    ndarray of float64, shape (len(sequence) - start, 4)
        x, y, w, h in pixels, 0-based.

    Raises
    ------
    DataError
        The file cannot be read, or has too few lines.
    """
    lines = read_boxes(path)
    wanted = len(sequence) - start
    if len(lines) > wanted and len(lines) >= sequence.last:
        lines = lines[sequence.first - 1 + start :]
    if len(lines) < wanted:
        raise DataError(f"{path}: {len(lines)} boxes for {wanted} frames")
    return lines[:wanted] - ONE_BASED


def _replace(path: Path, text: str) -> None:
    temporary = path.with_name(path.name + ".part")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)
