"""``mfcmt eval``: score trackers on OTB and its relatives."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from pathlib import Path

from ..otb.catalogue import resolve
from ..otb.dataset import Dataset, open_otb
from ..otb.document import to_markdown
from ..otb.report import Results, summary, write_report
from ..otb.runner import evaluate
from ..otb.score import Evaluation
from ..otb.trackers import Entry, ResultFolder
from . import UsageError

SUBSETS = {"otb2015": "OTB-2015", "otb2013": "OTB-2013", "tb50": "TB-50"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("MFCMT_OTB_ROOT", "../shared/data/otb")),
        help="folder of sequences (default: $MFCMT_OTB_ROOT)",
    )
    parser.add_argument(
        "--trackers",
        nargs="+",
        default=["default"],
        metavar="TRACKER",
        help="names, apart by comma or space: a preset, a configuration file (.toml, .json), "
        "a folder of result files; LABEL=TRACKER gives another name",
    )
    parser.add_argument("--protocol", default="ope", help="ope, tre, sre, apart by comma (default: ope)")
    parser.add_argument("--set", choices=SUBSETS, default="otb2015", help="which targets (default: otb2015)")
    parser.add_argument("--sequences", metavar="NAMES", help="only these, apart by comma")
    parser.add_argument(
        "--results",
        type=Path,
        default=Path("results"),
        help="folder of result files; finished work there is kept (default: results)",
    )
    parser.add_argument("--report", type=Path, metavar="FOLDER", help="write tables, plots, CSV and JSON there")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: one a CPU)")


def run(args: argparse.Namespace) -> int:
    """Run what is not finished, print a table for each protocol; 1 where a tracker lost a sequence."""
    protocols = [p.upper() for p in args.protocol.split(",")]
    if unknown := set(protocols) - {"OPE", "TRE", "SRE"}:
        raise UsageError(f"unknown protocol: {', '.join(sorted(unknown))}")
    dataset = _dataset(args)
    trackers = [resolve(text, args.results) for given in args.trackers for text in given.split(",") if text]
    lost = False
    results: Results = {}
    for protocol in protocols:
        evaluations = evaluate(
            dataset, trackers, protocol, results=args.results, jobs=args.jobs, progress=_progress(protocol)
        )
        results[protocol] = evaluations
        title = f"{dataset.name} {protocol}, {dataset.coverage} targets"
        print(to_markdown([title, summary(evaluations, dataset)]))
        lost |= _complain(trackers, evaluations)
    if args.report is not None:
        write_report(args.report, dataset, results, command=shlex.join(["mfcmt", *sys.argv[1:]]))
        print(args.report / "report.html")
    return int(lost)


def _dataset(args: argparse.Namespace) -> Dataset:
    if not args.data.is_dir():
        raise UsageError(f"no data at {args.data}: name the folder of sequences with --data")
    dataset = open_otb(args.data, SUBSETS[args.set])
    if args.sequences:
        return dataset.select(args.sequences.split(","))
    if dataset.missing:
        print(f"{dataset.coverage} targets; not here: {', '.join(dataset.missing)}", file=sys.stderr)
    return dataset


def _complain(trackers: list[Entry | ResultFolder], evaluations: list[Evaluation]) -> bool:
    """Name what was lost; whether a tracker that ran is among it."""
    ran = {t.name for t in trackers if not isinstance(t, ResultFolder)}
    for e in evaluations:
        for reason in list(e.missing.values())[:3]:
            print(f"{e.tracker}: {reason}", file=sys.stderr)
        if len(e.missing) > 3:
            print(f"{e.tracker}: {len(e.missing)} sequences have no score", file=sys.stderr)
    return any(e.missing and e.tracker in ran for e in evaluations)


class _progress:  # noqa: N801
    """A line on the terminal, rewritten at most five times a second."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._begun = time.monotonic()
        self._shown = 0.0

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if not sys.stderr.isatty() or (now - self._shown < 0.2 and done < total):
            return
        self._shown = now
        left = (now - self._begun) * (total - done) / max(done, 1)
        filled = 30 * done // max(total, 1)
        bar = "#" * filled + "." * (30 - filled)
        end = "\n" if done >= total else ""
        print(
            f"\r{self._label} [{bar}] {done}/{total} {left:4.0f} s left ",
            end=end,
            file=sys.stderr,
            flush=True,
        )
