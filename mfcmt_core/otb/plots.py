"""Success and precision plots as SVG, like figures 3 and 4 of the paper. Needs matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence as Seq
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .dataset import ATTRIBUTES, Dataset
from .document import PALETTE
from .metrics import NORM_PRECISION_THRESHOLDS, PRECISION_THRESHOLDS, SUCCESS_THRESHOLDS, Array
from .score import Evaluation
from .trust import Pool, calibration
from .trust import risk_coverage as curve
from .trust_tables import Said

TOP = 10
"""Trackers in a plot; the tables have all."""
POINTS = 200
"""Of a curve that has one for each frame."""

DASHES = ("-", "--", "-.")


@dataclass(frozen=True)
class Kind:
    """A sort of plot: which curve over which thresholds."""

    metric: str
    thresholds: Array
    title: str
    x_label: str
    y_label: str


SUCCESS = Kind("success", SUCCESS_THRESHOLDS, "Success", "Overlap threshold", "Success rate")
PRECISION = Kind("precision", PRECISION_THRESHOLDS, "Precision", "Centre error threshold (pixels)", "Precision")
NORM_PRECISION = Kind(
    "norm_precision",
    NORM_PRECISION_THRESHOLDS,
    "Normalised precision",
    "Centre error threshold (of the target's size)",
    "Precision",
)

_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "mfcmt",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.framealpha": 0.85,
}


def plot(kind: Kind, evaluations: Seq[Evaluation], title: str) -> str:
    """Return one plot of all sequences as SVG text. The legend is ranked and gives score and speed."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(5.6, 4.4), layout="constrained")
        _draw(figure.add_subplot(), kind, evaluations, title, None, _styles(evaluations), small=False)
        return _svg(figure)


def attribute_plots(kind: Kind, evaluations: Seq[Evaluation], dataset: Dataset, title: str) -> str:
    """Return a small plot for each attribute that some sequence has, as in figure 4 of the paper, as SVG text."""
    groups = {a: [s.name for s in dataset if a in s.attributes] for a in ATTRIBUTES}
    groups = {a: names for a, names in groups.items() if any(n in e.scores for e in evaluations for n in names)}
    rows = -(-len(groups) // 3)
    styles = _styles(evaluations)
    with rc_context(_STYLE):
        figure = Figure(figsize=(12.5, 3.6 * rows), layout="constrained")
        figure.suptitle(title)
        for place, (attribute, names) in enumerate(groups.items(), 1):
            some = [e for e in evaluations if any(n in e.scores for n in names)]
            heading = f"{ATTRIBUTES[attribute]} ({len(names)})"
            _draw(figure.add_subplot(rows, 3, place), kind, some, heading, names, styles, small=True)
        return _svg(figure)


def reliability(said: Said, title: str) -> str:
    """Return the reliability diagrams of trackers whose confidence is a probability, as SVG text."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(5.6, 4.4), layout="constrained")
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color="#888888", linewidth=1, linestyle=":")
        for index, (name, judged) in enumerate(list(said.items())[:TOP]):
            pool = Pool.of(judged)
            c = calibration(pool.confidence, pool.right, pool.weight)
            axes.plot(
                c.confidence,
                c.right,
                marker="o",
                markersize=3,
                color=PALETTE[index % len(PALETTE)],
                label=f"{name} [{c.error:.3f}]",
            )
        _label(axes, title, "Confidence", "Share of right boxes")
        return _svg(figure)


def risk_coverage(said: Said, title: str) -> str:
    """Return the risk–coverage curves of all trackers as SVG text."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(5.6, 4.4), layout="constrained")
        axes = figure.add_subplot()
        for index, (name, judged) in enumerate(list(said.items())[:TOP]):
            pool = Pool.of(judged)
            coverage, risk = curve(pool.confidence, pool.right, pool.weight)
            picked = np.linspace(0, len(coverage) - 1, min(len(coverage), POINTS)).astype(int)
            axes.plot(coverage[picked], risk[picked], color=PALETTE[index % len(PALETTE)], label=name)
        _label(axes, title, "Coverage: share of frames accepted", "Risk: share of these not right")
        return _svg(figure)


def _label(axes: Axes, title: str, x_label: str, y_label: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    axes.legend(loc="upper left", prop={"size": 7.5})


def _styles(evaluations: Seq[Evaluation]) -> dict[str, tuple[str, str]]:
    return {
        e.tracker: (PALETTE[i % len(PALETTE)], DASHES[i // len(PALETTE) % len(DASHES)])
        for i, e in enumerate(evaluations)
    }


def _draw(
    axes: Axes,
    kind: Kind,
    evaluations: Seq[Evaluation],
    title: str,
    names: list[str] | None,
    styles: dict[str, tuple[str, str]],
    *,
    small: bool,
) -> None:
    total = max(len(e.scores) for e in evaluations)
    ranked = sorted(evaluations, key=lambda e: -e.mean(kind.metric, names))[:TOP]
    for e in ranked:
        color, dashes = styles[e.tracker]
        speed = "" if e.fps is None else f" ({e.fps:.0f} FPS)"
        axes.plot(
            kind.thresholds,
            e.curve(f"{kind.metric}_curve", names),
            color=color,
            linestyle=dashes,
            linewidth=1.5,
            label=f"{_name(e, total)} [{e.mean(kind.metric, names):.3f}]{speed}",
        )
    axes.set_title(title, fontsize=9 if small else 11)
    axes.set_xlabel(kind.x_label)
    axes.set_ylabel(kind.y_label)
    axes.set_xlim(0, kind.thresholds[-1])
    axes.set_ylim(0, 1)
    axes.legend(loc="lower left" if kind is SUCCESS else "lower right", prop={"size": 6 if small else 7.5})


def _name(evaluation: Evaluation, total: int) -> str:
    """Return the name in the legend; a tracker without some of the results must not look like the others."""
    count = len(evaluation.scores)
    return evaluation.tracker if count == total else f"{evaluation.tracker}, {count} of {total}"


def _svg(figure: Figure) -> str:
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})  # no date: the same scores, the same file
    return text.getvalue()
