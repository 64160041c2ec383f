"""``mfcmt bench``: milliseconds a frame, stage by stage; ``--peers`` beside other trackers; ``--costs`` of the rest."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .. import synthetic
from ..config import PRESETS, MFCMTConfig
from ..tracker import MFCMT
from . import UsageError, costs, versus
from .measure import (
    STAGES,
    Material,
    StageClock,
    pin,
    real_lengths,
    real_material,
    spread,
    synthetic_material,
    timed_run,
    warm_up,
)
from .progress import Progress
from .variables import misspelt_variables

BUSY = 1.15
"""Ratio of wall time to processor time above which other work had the core, too."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--preset", choices=PRESETS, default="default")
    parser.add_argument("--clip", choices=synthetic.SCENES, help="a rendered clip (default: sample)")
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="real sequences instead of a rendered clip")
    parser.add_argument("--sequences", metavar="NAMES", help="only these, separated by commas")
    parser.add_argument("--frames", type=int, metavar="N", help="use at most N frames of each")
    parser.add_argument("--repeat", type=int, default=3, metavar="N", help="passes over the frames (default: 3)")
    parser.add_argument("--core", type=int, metavar="N", help="the core to run on (default: the last)")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument(
        "--peers",
        action="store_true",
        help="compare speed and accuracy with OpenCV's CSRT, KCF and MOSSE and with dlib in one run on the same frames "
        "(default: those of $MFCMT_OTB_ROOT); see make bench-peers",
    )
    parser.add_argument(
        "--costs",
        action="store_true",
        help="measure large frames, a lost target, ten targets and a second core on a rendered clip",
    )


def run(args: argparse.Namespace) -> int:
    """Measure, and print the report."""
    if args.repeat < 1 or (args.frames is not None and args.frames < 2):
        raise UsageError("--repeat takes 1 or more, --frames 2 or more")
    if args.clip and args.data:
        raise UsageError("--clip and --data exclude each other")
    if args.data and not args.data.is_dir():
        raise UsageError(f"no folder {args.data}")
    if args.core is not None and args.core not in getattr(os, "sched_getaffinity", lambda _: {args.core})(0):
        raise UsageError(f"no core {args.core} for this process")
    if args.costs and (args.peers or args.clip or args.data):
        raise UsageError("--costs renders its own clip and goes with neither --peers, --clip nor --data")
    for line in misspelt_variables():
        print(f"mfcmt bench: {line}", file=sys.stderr)
    machine = pin(args.core)
    if args.costs:
        report = costs.measure(MFCMTConfig.preset(args.preset), args.frames)
        text = costs.table(report)
    elif args.peers:
        default = versus.default_data()
        report = versus.measure(material(args, default), args.preset, frames_of(args, default))
        text = versus.table(report)
    else:
        report = measure(material(args), args.preset, args.repeat, frames_of(args))
        text = table(report)
    if args.json:
        print(json.dumps({"machine": machine} | report, indent=1, allow_nan=False))
    else:
        print(machine, text, sep="\n")
    return 0


def material(args: argparse.Namespace, default: Path | None = None) -> Iterator[Material]:
    """Yield the sequences that the arguments name."""
    data = args.data or (None if args.clip else default)
    if data:
        return real_material(data, args.sequences, args.frames)
    return synthetic_material(args.clip or "sample", args.frames)


def frames_of(args: argparse.Namespace, default: Path | None = None) -> int:
    """Return how many frames :func:`material` has, without decoding them."""
    data = args.data or (None if args.clip else default)
    lengths = real_lengths(data, args.sequences) if data else [synthetic.SCENES[args.clip or "sample"].length]
    return sum(min(args.frames or length, length) for length in lengths)


def measure(materials: Iterable[Material], preset: str, repeat: int, frames: int | None = None) -> dict[str, Any]:
    """Time whole updates first, then once more with a clock on each stage, and return the report.

    ``frames`` is the number of frames of all materials, for the time left.
    """
    with Progress(frames and frames * (repeat + 1)) as bar:
        return _measure(materials, preset, repeat, bar)


def _measure(materials: Iterable[Material], preset: str, repeat: int, bar: Progress) -> dict[str, Any]:
    config = MFCMTConfig.preset(preset)
    clock, clips = StageClock(), []
    updates, walls = [], []
    for item in materials:
        warm_up(MFCMT(config), item)
        runs = []
        for _ in range(repeat):
            runs.append(timed_run(MFCMT(config), item))
            bar.step(item.name, len(item.frames))
        cpu = np.concatenate([r.cpu[1:] for r in runs])
        tracked = cpu[~np.concatenate([r.lost[1:] for r in runs])]
        updates.append(cpu)
        walls.append(np.concatenate([r.wall[1:] for r in runs]))
        height, width = item.frames[0].shape[:2]
        clips.append(
            {"name": item.name, "frames": len(item.frames), "size": [width, height], "target": list(item.box[2:])}
            | {"init_ms": _milliseconds(np.array([r.cpu[0] for r in runs]))["median"]}
            | {"update_ms": _milliseconds(cpu), "fps": float(1 / cpu.mean())}
            | {"lost": 1 - len(tracked) / len(cpu), "p99_over_median": spread(tracked)}
        )
        tracker = MFCMT(config)
        tracker.init(item.frames[0], item.box)
        with clock.running():
            for frame in item.frames[1:]:
                tracker.update(frame)
                clock.end_frame()
        bar.step(item.name, len(item.frames))
    everything, wall = np.concatenate(updates), np.concatenate(walls)
    stages = {
        name: _milliseconds(np.array(clock.seconds[name])) | {"calls": float(np.mean(clock.calls[name]))}
        for name, _, _ in STAGES
    }
    return {
        "preset": preset,
        "repeat": repeat,
        "clips": clips,
        "stages_ms": stages,
        "update_ms": _milliseconds(everything),
        "fps": float(1 / everything.mean()),
        "wall_over_cpu": float(wall.sum() / everything.sum()),
    }


def _milliseconds(seconds: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    values = seconds * 1e3
    middle, p90, p99 = np.percentile(values, (50, 90, 99))
    return {"median": float(middle), "mean": float(values.mean()), "p90": float(p90), "p99": float(p99)}


def table(report: dict[str, Any]) -> str:
    """Return the report as text."""
    lines = [f"{report['preset']} preset, {report['repeat']} passes; milliseconds of processor time a frame", ""]
    lines.append(f"{'stage':<20}{'median':>9}{'mean':>9}{'p90':>9}{'calls':>8}")
    for name, stage in report["stages_ms"].items():
        if stage["calls"]:
            lines.append(
                f"{name:<20}{stage['median']:9.3f}{stage['mean']:9.3f}{stage['p90']:9.3f}{stage['calls']:8.2f}"
            )
    lines += [
        "",
        f"{'update':<20}{'median':>9}{'mean':>9}{'p90':>9}{'p99':>8}{'/median':>9}{'init':>8}{'frames/s':>10}",
    ]
    for clip in report["clips"]:
        u = clip["update_ms"]
        ratio = "–" if clip["p99_over_median"] is None else f"{clip['p99_over_median']:.2f}"
        row = f"{u['median']:9.3f}{u['mean']:9.3f}{u['p90']:9.3f}{u['p99']:8.2f}"
        lines.append(f"{clip['name']:<20}{row}{ratio:>9}{clip['init_ms']:8.2f}{clip['fps']:10.0f}")
    if len(report["clips"]) > 1:
        u = report["update_ms"]
        row = f"{u['median']:9.3f}{u['mean']:9.3f}{u['p90']:9.3f}{u['p99']:8.2f}"
        lines.append(f"{'all frames':<20}{row}{'':17}{report['fps']:10.0f}")
    lines.append("p99 / median: of the frames on which the target is not lost")
    first = report["clips"][0]
    if len(report["clips"]) == 1:
        (w, h), (tw, th) = first["size"], first["target"]
        lines.append(f"{first['frames']} frames of {w}×{h}, target {tw:.0f}×{th:.0f}")
    if report["wall_over_cpu"] > BUSY:
        lines.append(f"the core was busy with other work: wall time was {report['wall_over_cpu']:.2f} × as long")
    return "\n".join(lines)
