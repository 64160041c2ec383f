"""Read files of boxes: of several targets, in one source or in many."""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from math import isfinite
from pathlib import Path
from typing import Any

from ..exports import Target
from ..result import Box
from . import UsageError
from .targets import Start

HEADERS = {4: "x,y,w,h", 5: "file,x,y,w,h", 6: "file,name,x,y,w,h"}
"""What the columns of a CSV without a header are, by their number."""
KNOWN = frozenset({"file", "name", "class", "frame", "x", "y", "w", "h"})

Entry = dict[str, Any]


def read_boxes(path: Path, name: str, kind: str) -> dict[str, list[Start]]:
    """Return the boxes of a CSV or JSON file by the source that they are for, ``""`` if it names none.

    A CSV has the columns ``x, y, w, h`` and may have ``file, name, class, frame``; a JSON has a box, boxes by name, or
    a list of such entries, by file. ``name`` and ``kind`` are used where an entry has none; targets without a name are
    numbered. Raises UsageError.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        entries = _json(json.loads(text)) if path.suffix.lower() == ".json" else _csv(text)
    except (OSError, ValueError) as bad:
        raise UsageError(f"{path}: {bad.strerror if isinstance(bad, OSError) else bad}") from bad
    if not entries:
        raise UsageError(f"{path} has no boxes")
    found: dict[str, list[Start]] = defaultdict(list)
    numbers: dict[tuple[str, str], Target] = {}
    for place, entry in entries:
        try:
            box, frame = _box(entry), _frame(entry.get("frame", 0))
        except (KeyError, TypeError, ValueError) as bad:
            missing = f"{bad} is missing" if isinstance(bad, KeyError) else bad
            raise UsageError(f"{path}, {place}: {missing}") from bad
        file = str(entry.get("file") or "")
        called = str(entry.get("name") or "")
        if not called and (file, "") in numbers and found[file][-1].frame == frame:
            called = f"{name}-{len({s.target for s in found[file]}) + 1}"
        target = numbers.get((file, called))
        if target is None:
            of_file = sum(1 for key in numbers if key[0] == file)
            target = Target(of_file + 1, called or name, str(entry.get("class") or kind))
            numbers[file, called] = target
        found[file].append(Start(target, box, frame))
    return dict(found)


def once_each(starts: list[Start], path: Path) -> list[Start]:
    """Return the starts. Raises UsageError if a target has several."""
    seen: set[Target] = set()
    for start in starts:
        if start.target in seen:
            raise UsageError(f"{path}: {start.target.name} has several boxes: with --keyframes they are known places")
        seen.add(start.target)
    return starts


def _csv(text: str) -> list[tuple[str, Entry]]:
    rows = [row for row in csv.reader(text.splitlines()) if any(cell.strip() for cell in row)]
    if not rows:
        return []
    header = [cell.strip().lower() for cell in rows[0]]
    first = 1
    if "x" not in header:
        if len(rows[0]) not in HEADERS:
            raise ValueError(f"needs a first line with names of columns, {', '.join(sorted(KNOWN))}")
        header, first = HEADERS[len(rows[0])].split(","), 0
    if unknown := set(header) - KNOWN:
        raise ValueError(f"unknown column {', '.join(sorted(unknown))}; known are {', '.join(sorted(KNOWN))}")
    entries = []
    for number, row in enumerate(rows[first:], first + 1):
        if len(row) != len(header):
            raise ValueError(f"line {number} has {len(row)} values for {len(header)} columns")
        entries.append((f"line {number}", dict(zip(header, (cell.strip() for cell in row), strict=True))))
    return entries


def _json(document: Any) -> list[tuple[str, Entry]]:
    if isinstance(document, list):
        return [(f"entry {n}", _entry(one)) for n, one in enumerate(document, 1)]
    if not isinstance(document, dict):
        raise ValueError("is neither a list nor an object of boxes")
    found = []
    for file, value in document.items():
        if isinstance(value, dict) and not {"box", "x"} & value.keys():
            parts = [_entry(one) | {"name": name} for name, one in value.items()]
        elif isinstance(value, list) and not (value and isinstance(value[0], int | float)):
            parts = [_entry(one) for one in value]
        else:
            parts = [_entry(value)]
        found += [(file, {"file": file} | part) for part in parts]
    return found


def _entry(value: Any) -> Entry:
    if isinstance(value, dict):
        return value
    return {"box": value}


def _box(entry: Entry) -> Box:
    values = entry["box"] if "box" in entry else [entry[key] for key in ("x", "y", "w", "h")]
    x, y, w, h = (float(v) for v in values)
    if not all(map(isfinite, (x, y, w, h))) or w <= 0 or h <= 0:
        raise ValueError(f"the box has no area: {x:g},{y:g},{w:g},{h:g}")
    return x, y, w, h


def _frame(value: Any) -> int:
    frame = int(value or 0)
    if frame < 0:
        raise ValueError(f"frame {frame}: frames count from 0")
    return frame
