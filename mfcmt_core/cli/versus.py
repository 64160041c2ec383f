"""Measure speed and accuracy against the trackers of OpenCV and dlib, on the same frames in the same run."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..config import MFCMTConfig
from ..otb.peers import PEERS, Peer
from ..otb.protocol import Run
from ..otb.score import Evaluation, score_runs
from ..otb.trackers import Engine
from . import UsageError
from .measure import Material, Timed, spread, timed_run, warm_up
from .progress import Progress

OURS = "MFCMT"
PASSES = 3
"""Passes of ours for its slowest frames. Each does the same work, so the least time per frame leaves out the noise."""
FEWEST = 20
"""Smallest number of updates on which a peer must be alive in a sequence for its speed there to count."""

COLUMNS = (  # title, key, width, digits
    ("ms", "median_ms", 8, 3),
    ("× ours", "times_ours", 9, 2),
    ("least", "least", 8, 2),
    ("most", "most", 8, 2),
    ("timed on", "timed", 10, 0),
    ("alive", "alive", 8, 3),
    ("AUC", "auc", 8, 3),
    ("P@20", "precision", 8, 3),
)


def default_data() -> Path | None:
    """Return the folder of real sequences, or None if there is none."""
    root = Path(os.environ.get("MFCMT_OTB_ROOT", "../shared/data/otb"))
    return root if root.is_dir() else None


def measure(materials: Iterable[Material], preset: str, all_frames: int | None = None) -> dict[str, Any]:
    """Run every tracker on each sequence and return the report. The order of the trackers rotates.

    A frame on which a peer reports a lost target costs it almost nothing, so it does not count for its speed. Ours
    counts on every frame. Ratios are of medians, per sequence. ``all_frames`` is the number of frames of all materials,
    for the time left.
    """
    peers = [Peer(name, name) for name in PEERS]
    present = [p for p in peers if not p.lacks]
    if not present:
        raise UsageError("none of the peers is installed; make bench-peers installs them")
    entries: list[Engine | Peer] = [Engine(OURS, MFCMTConfig.preset(preset)), *present]
    scores = {e.name: Evaluation(e.name, "OPE", {}) for e in entries}
    medians: dict[str, dict[str, float]] = {e.name: {} for e in entries}
    alive: dict[str, list[float]] = {e.name: [] for e in entries}
    left_out = [f"{p.name}: needs {p.lacks}" for p in peers if p.lacks]
    spreads: dict[str, dict[str, float | None]] = {"one": {}, "least": {}}
    frames = 0
    with Progress(all_frames and all_frames * len(entries)) as bar:
        for turn, item in enumerate(materials):
            frames += len(item.frames)
            for k in range(len(entries)):
                entry = entries[(turn + k) % len(entries)]
                bar.begin(f"{item.name} {entry.name}", len(item.frames))
                try:
                    timed = _run(entry, item)
                except (cv2.error, RuntimeError, TypeError, ValueError) as failed:
                    if entry.name == OURS:
                        raise
                    left_out.append(f"{entry.name} on {item.name}: {type(failed).__name__}")
                    continue
                if entry.name == OURS:
                    again = [timed_run(entry.make(), item).cpu for _ in range(PASSES - 1)]
                    for name, cpu in (("one", timed.cpu), ("least", np.min([timed.cpu, *again], axis=0))):
                        spreads[name][item.name] = spread(cpu[1:][~timed.lost[1:]])
                score = score_runs(item.sequence, [(Run("", 0, item.box), timed.boxes)])
                scores[entry.name].scores[item.name] = score
                counted = timed.cpu[1:][timed.alive[1:]]
                alive[entry.name].append(float(timed.alive[1:].mean()))
                if len(counted) >= min(FEWEST, len(item.frames) - 1):
                    medians[entry.name][item.name] = float(np.median(counted) * 1e3)
                else:
                    left_out.append(
                        f"speed of {entry.name} on {item.name}: alive on {len(counted)} of {len(timed.cpu) - 1} frames"
                    )
    rows = [_row(e.name, scores[e.name], medians, alive[e.name]) for e in entries]
    sequences = {name: {e.name: medians[e.name].get(name) for e in entries} for name in medians[OURS]}
    return {"preset": preset, "frames": frames, "trackers": rows} | {
        "median_ms": sequences,
        "p99_over_median": spreads["least"],
        "p99_over_median_of_one_pass": spreads["one"],
        "left_out": left_out,
    }


def _run(entry: Engine | Peer, item: Material) -> Timed:
    warm_up(entry.make(), item)
    return timed_run(entry.make(), item)


def _row(name: str, evaluation: Evaluation, medians: dict[str, dict[str, float]], alive: list[float]) -> dict[str, Any]:
    ratios = np.array([ms / medians[OURS][s] for s, ms in medians[name].items()])
    row: dict[str, Any] = {"name": name, "sequences": len(evaluation.scores), "timed": len(ratios)}
    if len(ratios):
        row["median_ms"] = _geometric_mean(np.array(list(medians[name].values())))
        row |= {"times_ours": _geometric_mean(ratios), "least": float(ratios.min()), "most": float(ratios.max())}
    if evaluation.scores:
        row |= {"auc": evaluation.success, "precision": evaluation.precision, "alive": float(np.mean(alive))}
    return row


def _behind(medians: dict[str, dict[str, float | None]]) -> list[str]:
    """Return a line per peer with the sequences on which it was faster than ours."""
    faster: dict[str, list[str]] = {}
    for sequence, row in medians.items():
        ours = row[OURS]
        for name, ms in row.items():
            if ms is not None and ours is not None and ms < ours:
                faster.setdefault(name, []).append(sequence)
    return [f"{name}: {', '.join(sequences)}" for name, sequences in faster.items()]


def _middle_and_most(spreads: dict[str, float | None]) -> str:
    """Return the median and the largest value over the sequences as text; empty if there are none."""
    known = {name: s for name, s in spreads.items() if s is not None}
    if not known:
        return ""
    worst = max(known, key=lambda name: known[name])
    return f"{np.median(list(known.values())):.2f} and {known[worst]:.2f} ({worst})"


def _geometric_mean(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    return float(np.exp(np.log(values).mean()))


def table(report: dict[str, Any]) -> str:
    """Return the report as text."""
    count = len(report["median_ms"])
    head = "".join(f"{title:>{width}}" for title, _, width, _ in COLUMNS)
    lines = [
        f"{report['preset']} preset, {count} sequences, {report['frames']} frames; processor time of one update:",
        "median over the frames on which the tracker is alive, geometric mean over sequences",
        "",
        f"{'tracker':<14}{head}",
    ]
    for row in report["trackers"]:
        cells = (f"{row[key]:{w}.{digits}f}" if key in row else f"{'–':>{w}}" for _, key, w, digits in COLUMNS)
        lines.append(f"{row['name']:<14}" + "".join(cells))
    if least := _middle_and_most(report["p99_over_median"]):
        one = _middle_and_most(report["p99_over_median_of_one_pass"])
        lines += [
            "",
            f"{OURS}, p99 over median where the target is not lost, in the middle of the sequences and at most:",
            f"{least}, of each frame the least of {PASSES} passes; {one} in one pass",
        ]
    lines += ["", "slower than a peer on:", *([f"  {line}" for line in _behind(report["median_ms"])] or ["  none"])]
    if report["left_out"]:
        lines += ["", "left out:", *(f"  {line}" for line in report["left_out"])]
    return "\n".join(lines)
