"""The report of an evaluation: tables, plots and intervals, as Markdown, HTML, CSV and JSON."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import os
import platform
from collections.abc import Sequence as Seq
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .. import __version__
from .dataset import Dataset
from .document import Block, Heading, Picture, to_html, to_markdown
from .metrics import NORM_PRECISION_THRESHOLDS, PRECISION_THRESHOLDS, SUCCESS_THRESHOLDS
from .score import Evaluation
from .tables import METRICS, attributes, differences, per_sequence, published_figures, ranked, summary
from .trackers import code_hash

NAMES = {
    "OPE": "one-pass evaluation",
    "TRE": "temporal robustness evaluation, 20 starts",
    "SRE": "spatial robustness evaluation, 12 perturbed boxes",
    "STARTS": "three passes, from frames 1, 11 and 21",
}

Results = dict[str, list[Evaluation]]
"""Evaluations by protocol."""


def write_report(
    folder: Path,
    dataset: Dataset,
    results: Results,
    *,
    command: str = "",
    films: Seq[Picture] = (),
    trust: Seq[Block] = (),
) -> None:
    """Write ``report.html`` (self-contained), ``report.md`` and its plots, ``scores.csv``, ``scores.json``.

    The first tracker is the one that the others are compared with. Without matplotlib there are no plots.
    """
    folder.mkdir(parents=True, exist_ok=True)
    title = f"{dataset.name}: {dataset.coverage} targets"
    blocks = _blocks(title, dataset, results, command)
    blocks += trust
    if films:
        blocks += [Heading("Films"), *films]
    (folder / "report.md").write_text(to_markdown(blocks), encoding="utf-8")
    (folder / "report.html").write_text(to_html(title, blocks), encoding="utf-8")
    (folder / "scores.csv").write_text(to_csv(results), encoding="utf-8")
    (folder / "scores.json").write_text(json.dumps(to_dict(dataset, results), indent=1) + "\n", encoding="utf-8")
    for block in blocks:
        if isinstance(block, Picture):
            (folder / block.file).write_bytes(block.data)


def to_csv(results: Results) -> str:
    """Return CSV with a line for each protocol, tracker and sequence."""
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
    """Return all scores and curves as values that JSON can hold."""
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
    """Return the machine and the versions with which the figures were measured."""
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
        "cpu_fps": e.cpu_fps,
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
        blocks += [_absent(e, len(dataset)) for e in evaluations if e.missing]
    cited = published_figures(dataset.name)
    if cited.rows:
        blocks += [Heading("Published figures"), "Cited, not measured here; all targets of the set.", cited]
    return blocks


def _protocol(protocol: str, evaluations: list[Evaluation], dataset: Dataset) -> list[Block]:
    if not evaluations:
        return []
    blocks: list[Block] = [Heading(f"{protocol}, {NAMES[protocol]}"), summary(evaluations, dataset)]
    order = ranked(evaluations)
    label = f"{protocol} on {dataset.name} ({dataset.coverage} targets)"
    has_attributes = any(s.attributes for s in dataset)
    if importlib.util.find_spec("matplotlib"):
        from . import plots

        for kind in (plots.SUCCESS, plots.PRECISION, plots.NORM_PRECISION):
            name = f"{protocol.lower()}_{kind.metric}"
            heading = f"{kind.title} plots of {label}"
            blocks.append(Picture(name, heading, plots.plot(kind, order, heading).encode()))
        if has_attributes:
            heading = f"Success plots of {label} by attribute"
            svg = plots.attribute_plots(plots.SUCCESS, order, dataset, heading)
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
    return [*blocks, Heading(f"{protocol}: success / precision by target", 3), per_sequence(order, dataset)]


def _absent(e: Evaluation, total: int) -> str:
    if not e.scores:
        return f"{e.tracker} has no {e.protocol} results."
    return (
        f"{e.tracker} has no result on {len(e.missing)} of {total} targets, over which nothing is averaged: "
        f"{', '.join(e.missing)}. The reasons are in scores.csv."
    )
