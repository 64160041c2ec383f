"""The tables of a report."""

from __future__ import annotations

import csv
from collections.abc import Sequence as Seq
from importlib import resources
from typing import Any

from .compare import compare
from .dataset import ATTRIBUTES, Dataset
from .document import Strong, Table
from .score import Evaluation

METRICS = {"success": "success", "precision": "precision", "norm_precision": "norm. precision"}


def summary(evaluations: Seq[Evaluation], dataset: Dataset) -> Table:
    """Return success, precision, normalized precision and speed; ranked by success, the incomplete ones last."""
    order = ranked(evaluations)
    common = [s.name for s in dataset if all(s.name in e.scores for e in order)]
    uneven = bool(common) and any(len(e.scores) > len(common) for e in order)
    header = ["tracker", *METRICS.values(), "FPS", "FPS of CPU time", "mean of rates", "targets"]
    header += [f"success on the {len(common)} of all"] if uneven else []
    rows = []
    for e in order:
        row = [e.tracker, *(f"{e.mean(m):.3f}" for m in METRICS), *map(_number, (e.fps, e.cpu_fps, e.mean_rate))]
        row.append(f"{len(e.scores)} of {len(dataset)}" if len(e.scores) < len(dataset) else str(len(dataset)))
        rows.append(row + ([f"{e.mean('success', common):.3f}"] if uneven else []))
    return Table(header, rows)


def attributes(evaluations: Seq[Evaluation], dataset: Dataset, metric: str = "success") -> Table:
    """Return a row for each tracker and a column for each attribute with its number of targets; the best in bold."""
    groups = {a: [s.name for s in dataset if a in s.attributes] for a in ATTRIBUTES}
    groups = {a: names for a, names in groups.items() if names}
    order = ranked(evaluations, metric)
    columns = []
    for names in groups.values():
        values = [e.mean(metric, names) if any(n in e.scores for n in names) else None for e in order]
        best = max((v for v, e in zip(values, order, strict=True) if v is not None and not e.missing), default=None)
        columns.append([_best(v, best) for v in values])
    header = ["tracker", *(f"{a} ({len(names)})" for a, names in groups.items())]
    return Table(header, [[e.tracker, *(c[i] for c in columns)] for i, e in enumerate(order)])


def per_sequence(evaluations: Seq[Evaluation], dataset: Dataset) -> Table:
    """Return success and precision of each tracker on each sequence; ``–`` where there is no result."""
    header = ["sequence", "frames", *(e.tracker for e in evaluations)]
    rows = []
    for sequence in dataset:
        scores = [e.scores.get(sequence.name) for e in evaluations]
        best = max((s.success for s in scores if s), default=None)
        cells = [Strong(t) if s and s.success == best else t for s, t in zip(scores, map(_pair, scores), strict=True)]
        rows.append([sequence.name, str(len(sequence)), *cells])
    return Table(header, rows)


def differences(evaluations: Seq[Evaluation]) -> Table:
    """Return the first tracker minus each of the others, with paired 95 % bootstrap intervals."""
    first, *others = evaluations
    rows = []
    for other in others:
        if not (set(first.scores) & set(other.scores)):
            continue
        cells = []
        for metric in ("success", "precision"):
            d = compare(first, other, metric)
            text = f"{d.mean:+.3f} [{d.low:+.3f}, {d.high:+.3f}]"
            cells.append(Strong(text) if d.is_evidence else text)
            if metric == "success":
                counts = [f"{d.won} / {d.sequences - d.won - d.lost} / {d.lost}", str(d.sequences)]
        rows.append([other.tracker, *cells, *counts])
    return Table([f"{first.tracker} minus", "success", "precision", "better / even / worse", "targets"], rows)


def published_figures(subset: str) -> Table:
    """Return the figures of the literature with their source; an empty table for other benchmarks."""
    text = resources.files(__package__).joinpath("data/published.csv").read_text(encoding="utf-8")
    rows = [row for row in csv.DictReader(text.splitlines()) if row["set"] == subset]
    return Table(
        ["tracker", "success", "precision", "FPS", "measured on", "source"],
        [[r["tracker"], *(r[k] or "–" for k in ("success", "precision", "fps", "hardware", "source"))] for r in rows],
    )


def ranked(evaluations: Seq[Evaluation], metric: str = "success") -> list[Evaluation]:
    some = [e for e in evaluations if e.scores]
    return sorted(some, key=lambda e: (bool(e.missing), -e.mean(metric)))


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f}" if value >= 100 else f"{value:.1f}"


def _best(value: float | None, best: float | None) -> str:
    if value is None:
        return "–"
    return Strong(f"{value:.3f}") if value == best else f"{value:.3f}"


def _pair(score: Any) -> str:
    return "–" if score is None else f"{score.success:.3f} / {score.precision:.3f}"
