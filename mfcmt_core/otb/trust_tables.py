"""The part of a report that says how far each tracker's own word can be trusted."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from collections.abc import Sequence as Seq

import numpy as np

from .document import Block, Heading, Picture, Table
from .trust import (
    REFUSED,
    STATUSES,
    Judged,
    Pool,
    absent_tracked,
    long_term,
    measure,
    status_table,
    tracked_wrong,
)

Said = Mapping[str, Seq[Judged]]
"""What each tracker said, by its name."""

NOTE = (
    "A frame is right where the overlap is above 0.5, wrong where it is below 0.1; each sequence weighs alike. "
    "AUROC: how well the confidence ranks right above other frames, 0.5 for a coin. Caught: the share of wrong frames "
    f"below the value that {REFUSED:.0%} of the right ones are below. Both with 95 % bootstrap intervals over the "
    "sequences. Calibration error: mean distance of confidence and share of right frames over ten bins; a dash where "
    "the number is no probability."
)


def trust_blocks(protocol: str, said: Said) -> list[Block]:
    """Return tables and plots of the trackers that say how sure they are; empty if none does."""
    said = {name: judged for name, judged in said.items() if any(j.present.any() for j in judged)}
    if not said:
        return []
    blocks: list[Block] = [Heading(f"{protocol}: how far to trust each tracker", 3), NOTE, ranking(said)]
    if importlib.util.find_spec("matplotlib"):
        from . import plots

        name = protocol.lower()
        probable = {n: j for n, j in said.items() if Pool.of(j).is_probability}
        if probable:
            title = "Reliability diagram: how often boxes of each confidence are right"
            blocks.append(Picture(f"{name}_reliability", title, plots.reliability(probable, title).encode()))
        title = "Risk and coverage: boxes that are not right among those of the highest confidence"
        blocks.append(Picture(f"{name}_risk", title, plots.risk_coverage(said, title).encode()))
    if (table := statuses(said)).rows:
        blocks += [Heading(f"{protocol}: status against truth", 3), table]
    if (table := absences(said)).rows:
        blocks += [Heading(f"{protocol}: films in which the target is away", 3), table]
    return blocks


def ranking(said: Said) -> Table:
    """Return AUROC, caught share and calibration error, the best ranking first."""
    measured = {name: measure(judged) for name, judged in said.items()}
    order = sorted(measured, key=lambda name: -np.nan_to_num(measured[name].auroc))
    rows = []
    for name in order:
        m = measured[name]
        rows.append(
            [
                name,
                _with_interval(m.auroc, m.auroc_interval),
                _with_interval(m.caught, m.caught_interval),
                _number(m.calibration_error),
                str(m.sequences),
            ]
        )
    return Table(["tracker", "AUROC", f"caught at {REFUSED:.0%}", "calibration error", "targets"], rows)


def statuses(said: Said) -> Table:
    """Return the share of frames with each status, by truth, and the share of wrong frames among the tracked ones."""
    rows = []
    for name, judged in said.items():
        pool = Pool.of(judged)
        if not (pool.status >= 0).any():
            continue
        shares = [_number(v) for row in status_table(pool)[[0, 2]] for v in row]
        rows.append([name, *shares, _number(tracked_wrong(pool))])
    header = [f"{truth}: {status}" for truth in ("right", "wrong") for status in STATUSES]
    return Table(["tracker", *header, "wrong among tracking"], rows)


def absences(said: Said) -> Table:
    """Return VOT-LT's precision, recall and F on the sequences with absent frames, and the share called tracking."""
    rows = []
    for name, judged in said.items():
        away = [j for j in judged if not j.present.all()]
        if away:
            best = long_term(away)
            shares = (best.precision, best.recall, best.f, absent_tracked(away))
            rows.append([name, *map(_number, shares), str(len(away))])
    return Table(["tracker", "precision", "recall", "F", "absent frames called tracking", "targets"], rows)


def _with_interval(value: float, interval: tuple[float, float]) -> str:
    return f"{_number(value)} [{_number(interval[0])}, {_number(interval[1])}]" if np.isfinite(value) else "–"


def _number(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"
