"""Result files: boxes as OTB text, one file a run, and beside them what they were made with.

``<root>/OPE/<tracker>/<Sequence>.txt`` holds ``x,y,w,h`` a frame, 1-based, three decimals, as the toolkit and
got10k read it; runs of TRE and SRE carry their key: ``David.07.txt``, ``David.topLeft.txt``.
``<Sequence>.json`` tells code, configuration, start and time of each run: what is named there is finished.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .dataset import ONE_BASED, Sequence, read_boxes
from .errors import DataError
from .metrics import Array
from .protocol import Run
from .score import Speed


@dataclass
class Record:
    """The finished runs of a tracker on a sequence by key, or why there are none. ``identity`` is a hash."""

    identity: str
    made_with: dict[str, Any]
    runs: dict[str, dict[str, Any]] = field(default_factory=dict)
    error: str | None = None

    def has(self, run: Run, frames: int) -> bool:
        """Whether this very run is finished."""
        wanted = {"start": run.start, "box": list(run.box), "frames": frames}
        return wanted.items() <= self.runs.get(run.key, {}).items()

    @property
    def speed(self) -> Speed | None:
        """Of all runs together; None where nothing is finished."""
        frames = sum(run["frames"] for run in self.runs.values())
        if not frames:
            return None
        rate = sum(run["mean_rate"] * run["frames"] for run in self.runs.values()) / frames
        cpu_seconds = sum(run.get("cpu_seconds", 0.0) for run in self.runs.values())
        return Speed(frames, sum(run["seconds"] for run in self.runs.values()), rate, cpu_seconds)


def read_record(path: Path) -> Record | None:
    """The record in a file; None where there is none that can be read."""
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
        """What is known of this pair; None where nothing is."""
        return read_record(self.folder(protocol, tracker) / f"{sequence}.json")

    def write(self, protocol: str, tracker: str, sequence: str, record: Record, boxes: dict[str, Array]) -> None:
        """Keep new boxes by run key (0-based), then the record: a crash in between leaves runs unfinished."""
        folder = self.folder(protocol, tracker)
        folder.mkdir(parents=True, exist_ok=True)
        for key, values in boxes.items():
            write_boxes(self.boxes_path(protocol, tracker, sequence, key), values)
        _replace(folder / f"{sequence}.json", json.dumps(vars(record), indent=1) + "\n")


def write_boxes(path: Path, boxes: Array) -> None:
    """Write 0-based boxes as OTB text."""
    rows = boxes + ONE_BASED
    _replace(path, "".join("{:.3f},{:.3f},{:.3f},{:.3f}\n".format(*row) for row in rows))


def read_result(path: Path, sequence: Sequence, start: int = 0) -> Array:
    """Boxes (0-based) of a run that began at index ``start`` of the sequence.

    A file longer than the sequence is cut: by frame number where it has a line for each frame from number 1
    on, else at its end, as the toolkit does. Raises DataError for one that is too short.
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
