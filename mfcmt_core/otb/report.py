"""The report of an evaluation: tables, plots and intervals, as Markdown, HTML, CSV and JSON."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import os
import platform
from collections.abc import Sequence as Seq
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .. import __version__
from .compare import compare
from .dataset import ATTRIBUTES, Dataset
from .document import Block, Heading, Picture, Strong, Table, to_html, to_markdown
from .metrics import NORM_PRECISION_THRESHOLDS, PRECISION_THRESHOLDS, SUCCESS_THRESHOLDS
from .score import Evaluation
from .trackers import code_hash

METRICS = {"success": "success", "precision": "precision", "norm_precision": "norm. precision"}
NAMES = {
    "OPE": "one-pass evaluation",
    "TRE": "temporal robustness evaluation, 20 starts",
    "SRE": "spatial robustness evaluation, 12 perturbed boxes",
}

Results = dict[str, list[Evaluation]]
"""Evaluations by protocol."""


def write_report(
    folder: Path, dataset: Dataset, results: Results, *, command: str = "", films: Seq[Picture] = ()
) -> None:
    """Write ``report.html`` (self-contained), ``report.md`` and its plots, ``scores.csv``, ``scores.json``.

    The first tracker is the one that the others are compared with. Without matplotlib there are no plots.
    """
    folder.mkdir(parents=True, exist_ok=True)
    title = f"{dataset.name}: {dataset.coverage} targets"
    blocks = _blocks(title, dataset, results, command)
    if films:
        blocks += [Heading("Films"), *films]
    (folder / "report.md").write_text(to_markdown(blocks), encoding="utf-8")
    (folder / "report.html").write_text(to_html(title, blocks), encoding="utf-8")
    (folder / "scores.csv").write_text(to_csv(results), encoding="utf-8")
    (folder / "scores.json").write_text(json.dumps(to_dict(dataset, results), indent=1) + "\n", encoding="utf-8")
    for block in blocks:
        if isinstance(block, Picture):
            (folder / block.file).write_bytes(block.data)


def summary(evaluations: Seq[Evaluation], dataset: Dataset) -> Table:
    """Success, precision, normalised precision and speed; ranked by success, the incomplete ones last."""
    ranked = _ranked(evaluations)
    common = [s.name for s in dataset if all(s.name in e.scores for e in ranked)]
    uneven = bool(common) and any(len(e.scores) > len(common) for e in ranked)
    header = ["tracker", *METRICS.values(), "FPS", "mean of rates", "targets"]
    header += [f"success on the {len(common)} of all"] if uneven else []
    rows = []
    for e in ranked:
        row = [e.tracker, *(f"{e.mean(m):.3f}" for m in METRICS), _number(e.fps), _number(e.mean_rate)]
        row.append(f"{len(e.scores)} of {len(dataset)}" if len(e.scores) < len(dataset) else str(len(dataset)))
        rows.append(row + ([f"{e.mean('success', common):.3f}"] if uneven else []))
    return Table(header, rows)


def attributes(evaluations: Seq[Evaluation], dataset: Dataset, metric: str = "success") -> Table:
    """A row a tracker, a column for each attribute with its number of targets; the best in bold."""
    groups = {a: [s.name for s in dataset if a in s.attributes] for a in ATTRIBUTES}
    groups = {a: names for a, names in groups.items() if names}
    ranked = _ranked(evaluations, metric)
    columns = []
    for names in groups.values():
        values = [e.mean(metric, names) if any(n in e.scores for n in names) else None for e in ranked]
        best = max((v for v, e in zip(values, ranked, strict=True) if v is not None and not e.missing), default=None)
        columns.append([_best(v, best) for v in values])
    header = ["tracker", *(f"{a} ({len(names)})" for a, names in groups.items())]
    return Table(header, [[e.tracker, *(c[i] for c in columns)] for i, e in enumerate(ranked)])


def per_sequence(evaluations: Seq[Evaluation], dataset: Dataset) -> Table:
    """Success and precision of each tracker on each sequence; ``–`` where there is no result."""
    header = ["sequence", "frames", *(e.tracker for e in evaluations)]
    rows = []
    for sequence in dataset:
        scores = [e.scores.get(sequence.name) for e in evaluations]
        best = max((s.success for s in scores if s), default=None)
        cells = [Strong(t) if s and s.success == best else t for s, t in zip(scores, map(_pair, scores), strict=True)]
        rows.append([sequence.name, str(len(sequence)), *cells])
    return Table(header, rows)


def differences(evaluations: Seq[Evaluation]) -> Table:
    """The first tracker minus each of the others, with paired 95 % bootstrap intervals."""
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
    """What the literature says, with its source; empty for other benchmarks."""
    text = resources.files(__package__).joinpath("data/published.csv").read_text(encoding="utf-8")
    rows = [row for row in csv.DictReader(text.splitlines()) if row["set"] == subset]
    return Table(
        ["tracker", "success", "precision", "FPS", "measured on", "source"],
        [[r["tracker"], *(r[k] or "–" for k in ("success", "precision", "fps", "hardware", "source"))] for r in rows],
    )


def to_csv(results: Results) -> str:
    """A line for each protocol, tracker and sequence."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["protocol", "tracker", "sequence", *METRICS, "frames", "fps", "mean_rate", "missing"])
    for protocol, evaluations in results.items():
        for e in evaluations:
            for name, s in e.scores.items():
                speed = [f"{s.speed.frames / s.speed.seconds:.2f}", f"{s.speed.mean_rate:.2f}"] if s.speed else ["", ""]
                values = [f"{getattr(s, m):.6f}" for m in METRICS]
                writer.writerow([protocol, e.tracker, name, *values, s.frames, *speed, ""])
            for name, reason in e.missing.items():
                writer.writerow([protocol, e.tracker, name, "", "", "", "", "", "", reason])
    return text.getvalue()


def to_dict(dataset: Dataset, results: Results) -> dict[str, Any]:
    """Everything, curves included, for JSON."""
    return {
        "dataset": {
            "name": dataset.name,
            "targets": list(dataset.sequences),
            "missing": list(dataset.missing),
        },
        "machine": machine(),
        "thresholds": {
            "success": SUCCESS_THRESHOLDS.round(2).tolist(),
            "precision": PRECISION_THRESHOLDS.tolist(),
            "norm_precision": NORM_PRECISION_THRESHOLDS.tolist(),
        },
        "protocols": {p: [_evaluation(e) for e in evaluations] for p, evaluations in results.items()},
    }


def machine() -> dict[str, str]:
    """What the figures were measured with."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    return {
        "mfcmt": f"{__version__} (code {code_hash()})",
        "cpu": f"{model}, {os.cpu_count()} threads",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


def _evaluation(e: Evaluation) -> dict[str, Any]:
    return {
        "tracker": e.tracker,
        **({m: e.mean(m) for m in METRICS} if e.scores else {}),
        "fps": e.fps,
        "mean_rate": e.mean_rate,
        "missing": e.missing,
        "sequences": {
            name: {
                **{m: getattr(s, m) for m in METRICS},
                **{f"{m}_curve": getattr(s, f"{m}_curve").round(6).tolist() for m in METRICS},
                "frames": s.frames,
            }
            for name, s in e.scores.items()
        },
    }


def _blocks(title: str, dataset: Dataset, results: Results, command: str) -> list[Block]:
    blocks: list[Block] = [Heading(title, 1)]
    if dataset.missing:
        blocks.append(f"{dataset.coverage} targets are here. Not here: {', '.join(dataset.missing)}.")
    if command:
        blocks.append(f"Command: {command}")
    blocks.append("Measured with " + ", ".join(f"{k} {v}" for k, v in machine().items()) + ".")
    for protocol, evaluations in results.items():
        blocks += _protocol(protocol, [e for e in evaluations if e.scores], dataset)
        lost = [f"{e.tracker}, {n}: {reason}" for e in evaluations for n, reason in e.missing.items()]
        if lost:
            blocks += [Heading(f"{protocol}: without a result", 3), *_shortened(lost)]
    cited = published_figures(dataset.name)
    if cited.rows:
        blocks += [Heading("Published figures"), "Cited, not measured here; all targets of the set.", cited]
    return blocks


def _protocol(protocol: str, evaluations: list[Evaluation], dataset: Dataset) -> list[Block]:
    if not evaluations:
        return []
    blocks: list[Block] = [Heading(f"{protocol}, {NAMES[protocol]}"), summary(evaluations, dataset)]
    ranked = _ranked(evaluations)
    label = f"{protocol} on {dataset.name} ({dataset.coverage} targets)"
    has_attributes = any(s.attributes for s in dataset)
    if importlib.util.find_spec("matplotlib"):
        from . import plots

        for kind in (plots.SUCCESS, plots.PRECISION, plots.NORM_PRECISION):
            name = f"{protocol.lower()}_{kind.metric}"
            heading = f"{kind.title} plots of {label}"
            blocks.append(Picture(name, heading, plots.plot(kind, ranked, heading).encode()))
        if has_attributes:
            heading = f"Success plots of {label} by attribute"
            svg = plots.attribute_plots(plots.SUCCESS, ranked, dataset, heading)
            blocks.append(Picture(f"{protocol.lower()}_attributes", heading, svg.encode()))
    else:
        blocks.append("No plots: matplotlib is not installed (pip install 'mfcmt[eval]').")
    if len(evaluations) > 1:
        note = (
            "Differences with paired 95 % bootstrap intervals over the targets; in bold where the interval "
            "leaves out 0. A target counts as even within 0.01."
        )
        blocks += [Heading(f"{protocol}: differences", 3), note, differences(evaluations)]
    if has_attributes:
        for metric in ("success", "precision"):
            heading = f"{protocol}: {metric} by attribute (targets)"
            blocks += [Heading(heading, 3), attributes(evaluations, dataset, metric)]
    return [*blocks, Heading(f"{protocol}: success / precision by target", 3), per_sequence(ranked, dataset)]


def _shortened(lines: list[str], most: int = 40) -> list[str]:
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more: see scores.csv."]


def _ranked(evaluations: Seq[Evaluation], metric: str = "success") -> list[Evaluation]:
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
