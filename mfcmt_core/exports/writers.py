"""Open an export by the name of its format, and write rows to it as they come."""

from __future__ import annotations

import json
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from ..files import replaced
from .coco import coco
from .cvat import cvat
from .labelstudio import labelstudio
from .lines import LINES, csv_header
from .rows import Clip, Row
from .yolo import yolo

FORMATS = (*LINES, "coco", "cvat", "labelstudio", "yolo")
SUFFIXES = {
    ".csv": "csv",
    ".jsonl": "jsonl",
    ".ndjson": "jsonl",
    ".json": "jsonl",
    ".txt": "otb",
    ".xml": "cvat",
}
"""The format that the suffix of an output means."""


@dataclass(frozen=True)
class Options:
    """How to write: format, output (None: the standard output), tolerance in pixels, whether keyframes were given."""

    format: str = "csv"
    output: Path | None = None
    tolerance: float = 2.0
    keyframes: bool = False
    flush: bool = False


class Writer(ABC):
    """Takes the rows of one frame after the other. ``close`` completes the export. Both raise OSError."""

    @abstractmethod
    def write(self, rows: Sequence[Row]) -> None:
        """Take the rows of a frame, one a target."""

    @abstractmethod
    def close(self, length: int) -> None:
        """Complete the export. ``length`` is the number of frames of the clip."""


def open_writer(options: Options, clip: Clip) -> Writer:
    """Return the writer of ``options.format``, one of :data:`FORMATS`. Raises OSError."""
    return _Lines(options) if options.format in LINES else _Document(options, clip)


class _Lines(Writer):
    """Writes each row at once, so that nothing of what was tracked is lost with the process."""

    def __init__(self, options: Options) -> None:
        self._line = LINES[options.format]
        self._own = options.output is not None
        self._flush = options.flush
        self._sink: TextIO = sys.stdout
        if options.output is not None:
            self._sink = options.output.open("w", encoding="utf-8", newline="\n", buffering=1)
        if options.format == "csv":
            self._sink.write(csv_header(keyframes=options.keyframes) + "\n")

    def write(self, rows: Sequence[Row]) -> None:
        text = "".join(f"{line}\n" for line in map(self._line, rows) if line)
        self._sink.write(text)
        if self._flush:
            self._sink.flush()

    def close(self, length: int) -> None:  # noqa: ARG002
        if self._own:
            self._sink.close()
        else:
            self._sink.flush()


class _Document(Writer):
    """Keeps the rows, and writes the document when all are there."""

    def __init__(self, options: Options, clip: Clip) -> None:
        self._options, self._clip = options, clip
        self._rows: list[Row] = []
        if options.output is not None and options.format != "yolo":
            with replaced(options.output, check=True):  # say now and not after an hour that it cannot be written
                pass

    def write(self, rows: Sequence[Row]) -> None:
        self._rows += rows

    def close(self, length: int) -> None:
        options, clip = self._options, self._clip
        if options.format == "yolo":
            assert options.output is not None
            yolo(options.output, clip, self._rows)
            return
        if options.format == "cvat":
            data = cvat(clip, self._rows, options.tolerance, length)
        else:
            document = (
                coco(clip, self._rows)
                if options.format == "coco"
                else labelstudio(clip, self._rows, options.tolerance, length)
            )
            data = json.dumps(document, ensure_ascii=False, indent=1).encode() + b"\n"
        if options.output is None:
            sys.stdout.write(data.decode())
            sys.stdout.flush()
            return
        with replaced(options.output) as partial:
            partial.write_bytes(data)
