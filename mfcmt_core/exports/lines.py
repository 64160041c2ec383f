"""Rows as lines of text: CSV, JSON lines, OTB, MOT."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import asdict

from .rows import Row

COLUMNS = (
    "frame",
    "time_s",
    "target",
    "x",
    "y",
    "w",
    "h",
    "status",
    "reliable",
    "fused",
    "template",
    "statistical",
    "psr",
    "updated",
    "scale",
    "confidence",
    "keyframe",
)
"""Columns of the CSV. ``keyframe`` is there only where keyframes were given."""


def csv_header(*, keyframes: bool) -> str:
    """Return the first line of a CSV."""
    return ",".join(COLUMNS if keyframes else COLUMNS[:-1])


def csv_line(row: Row) -> str:
    """Return the values of :data:`COLUMNS`."""
    result, scores = row.result, row.result.scores
    three = (scores.fused, scores.template, scores.statistical) if scores else (None,) * 3
    values = [
        row.frame,
        time_of(row),
        row.target.name,
        *result.box,
        result.status,
        result.reliable,
        *three,
        result.psr,
        result.updated,
        result.scale,
        result.confidence,
        *([] if row.keyframe is None else [row.keyframe]),
    ]
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([_plain(v) for v in values])
    return line.getvalue()


def time_of(row: Row) -> float | None:
    """Return the time of a row, to a microsecond."""
    return None if row.time_s is None else round(row.time_s, 6)


def _plain(value: object) -> object:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else value


def json_line(row: Row) -> str:
    """Return a JSON object with the whole result."""
    values = asdict(row.result)
    del values["maps"]
    about: dict[str, object] = {"frame": row.frame, "time_s": time_of(row), "target": row.target.name}
    if row.keyframe is not None:
        about["keyframe"] = row.keyframe
    return json.dumps(about | values, allow_nan=False)


def otb_line(row: Row) -> str:
    """Return the box with pixels counted from 1."""
    x, y, w, h = row.result.box
    return f"{x + 1:.3f},{y + 1:.3f},{w:.3f},{h:.3f}"


def mot_line(row: Row) -> str:
    """Return frame and pixels from 1, the target's number, and the confidence; nothing for a lost target."""
    if row.result.status == "lost":
        return ""
    return f"{row.frame + 1},{row.target.id},{otb_line(row)},{row.result.confidence:.4f},-1,-1,-1"


LINES: dict[str, Callable[[Row], str]] = {"csv": csv_line, "jsonl": json_line, "otb": otb_line, "mot": mot_line}
