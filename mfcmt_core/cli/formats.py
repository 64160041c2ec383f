"""Write results as lines of text: CSV, JSON lines, OTB, MOT."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict

from ..result import TrackResult

Row = Callable[[int, TrackResult], str]

COLUMNS = "frame,x,y,w,h,status,reliable,fused,template,statistical,psr,updated,scale,confidence"


def _csv(frame: int, result: TrackResult) -> str:
    scores = result.scores
    three = (scores.fused, scores.template, scores.statistical) if scores else (None,) * 3
    values = (
        frame,
        *result.box,
        result.status,
        result.reliable,
        *three,
        result.psr,
        result.updated,
        result.scale,
        result.confidence,
    )
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([_plain(v) for v in values])
    return line.getvalue()


def _plain(value: object) -> object:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else value


def _jsonl(frame: int, result: TrackResult) -> str:
    values = asdict(result)
    del values["maps"]
    return json.dumps({"frame": frame} | values, allow_nan=False)


def _otb(_: int, result: TrackResult) -> str:
    x, y, w, h = result.box
    return f"{x + 1:.3f},{y + 1:.3f},{w:.3f},{h:.3f}"


def _mot(frame: int, result: TrackResult) -> str:
    """1-based frame, id and box; the confidence as ``conf``; a lost target has no line."""
    if result.status == "lost":
        return ""
    return f"{frame + 1},1,{_otb(frame, result)},{result.confidence:.4f},-1,-1,-1"


FORMATS: dict[str, tuple[str, Row]] = {
    "csv": (COLUMNS, _csv),
    "jsonl": ("", _jsonl),
    "otb": ("", _otb),
    "mot": ("", _mot),
}
"""Header line and row function of each format. Frames and pixels count from 0, in OTB and MOT from 1."""

SUFFIXES = {".csv": "csv", ".jsonl": "jsonl", ".ndjson": "jsonl", ".json": "jsonl", ".txt": "otb"}


def lines(name: str, results: Iterator[TrackResult]) -> Iterator[tuple[TrackResult, str]]:
    """Yield each result with the text to write for it, line ends and header included."""
    header, row = FORMATS[name]
    start = header + "\n" if header else ""
    for frame, result in enumerate(results):
        line = row(frame, result)
        yield result, start + line + "\n" * bool(line)
        start = ""
