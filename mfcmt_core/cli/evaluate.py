"""``mfcmt eval``: score trackers on OTB and its relatives."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence as Seq
from contextlib import suppress
from functools import partial
from pathlib import Path

import cv2

from ..errors import DataError, NoData
from ..otb import film
from ..otb.batch import LOCAL
from ..otb.between import between_keyframes, between_table
from ..otb.catalogue import resolve
from ..otb.dataset import Dataset
from ..otb.document import Block, Picture, to_markdown
from ..otb.fit import constants, fit, held_out, record_all
from ..otb.layouts import LAYOUTS, open_dataset
from ..otb.protocol import PROTOCOLS
from ..otb.report import Results, write_report
from ..otb.reproduce import reproduce
from ..otb.runner import boxes_of, evaluate, judged
from ..otb.score import Evaluation
from ..otb.tables import summary
from ..otb.trackers import Engine, Entry, ResultFolder
from ..otb.trust_tables import absences, ranking, statuses, trust_blocks
from . import UsageError, add_batch
from .progress import Progress
from .variables import misspelt_variables

WANTED = (
    "name a folder of sequences with --data or MFCMT_OTB_ROOT, each with its images in NAME/img and its boxes in "
    "NAME/groundtruth_rect.txt; docs/evaluation.md has where to get OTB, which is not part of this project"
)
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
        help="names separated by commas or spaces: a preset, a configuration file (.toml, .json), "
        "a folder of result files; LABEL=TRACKER gives another name",
    )
    parser.add_argument("--protocol", default="ope", help="ope, tre, sre, starts, separated by commas (default: ope)")
    parser.add_argument("--layout", choices=["auto", *LAYOUTS], default="auto", help="how the folder is laid out")
    parser.add_argument("--set", choices=SUBSETS, default="otb2015", help="which targets (default: otb2015)")
    parser.add_argument("--sequences", metavar="NAMES", help="only these, separated by commas")
    parser.add_argument(
        "--results",
        type=Path,
        default=Path("results"),
        help="folder of result files; finished work there is kept (default: results)",
    )
    parser.add_argument("--report", type=Path, metavar="FOLDER", help="write tables, plots, CSV and JSON there")
    parser.add_argument("--film", metavar="NAMES", help="add film strips of these sequences to the report (OPE)")
    parser.add_argument("--video", action="store_true", help="also write the whole film of each strip as MP4")
    parser.add_argument(
        "--trust",
        action="store_true",
        help="also measure how far each tracker's own confidence and status can be trusted",
    )
    parser.add_argument(
        "--fit-confidence",
        nargs="+",
        type=Path,
        metavar="FOLDER",
        help="fit the constants of the confidence to the sequences of these folders and print them, with what they "
        "are worth on data sets that were left out",
    )
    parser.add_argument(
        "--reproduce",
        type=Path,
        metavar="FOLDER",
        help="reproduce section IV of the paper: write pages on presets, other trackers and ablations to the folder",
    )
    parser.add_argument("--published", type=Path, metavar="FOLDER", help="folders of published boxes for --reproduce")
    parser.add_argument(
        "--keyframes",
        metavar="N",
        help="measure what lies between known boxes in every Nth frame (30,60,120) against lines between them and "
        "against tracking forward alone",
    )
    add_batch(parser)


def run(args: argparse.Namespace) -> int:
    """Run what is not finished and print a table per protocol. Return 1 if a tracker failed on a sequence."""
    if args.fit_confidence:
        return _fit(args)
    if args.keyframes:
        return _keyframes(args)
    protocols = [p.upper() for p in args.protocol.split(",")]
    if unknown := set(protocols) - set(PROTOCOLS):
        raise UsageError(f"unknown protocol: {', '.join(sorted(unknown))}")
    if (args.film or args.video) and not (args.film and args.report and "OPE" in protocols):
        raise UsageError("--film names sequences, needs --report and OPE; --video needs --film")
    dataset = _dataset(args)
    if args.reproduce is not None:
        run = partial(_evaluate, args, dataset)
        reproduce(args.reproduce, dataset, protocols, args.results, args.published, run)
        print(args.reproduce / "claims.md")
        return 0
    trackers = [resolve(text, args.results) for given in args.trackers for text in given.split(",") if text]
    lost = False
    results: Results = {}
    trust: list[Block] = []
    for protocol in protocols:
        results[protocol] = evaluations = _evaluate(args, dataset, trackers, protocol)
        title = f"{dataset.name} {protocol}, {dataset.coverage} targets"
        print(to_markdown([title, summary(evaluations, dataset)]))
        lost |= _complain(trackers, evaluations)
        if args.trust:
            blocks = trust_blocks(protocol, {t.name: judged(t, dataset, protocol, args.results) for t in trackers})
            print(to_markdown([b for b in blocks if not isinstance(b, Picture)] or ["No tracker says how sure it is."]))
            trust += blocks
    if args.report is not None:
        films = _films(args, dataset, trackers)
        command = shlex.join(["mfcmt", *sys.argv[1:]])
        write_report(args.report, dataset, results, command=command, films=films, trust=trust)
        print(args.report / "report.html")
    return int(lost)


def _fit(args: argparse.Namespace) -> int:
    """Fit the confidence of the tracker that is asked for, and print what the fit is worth and its constants."""
    trackers = [resolve(text, args.results) for given in args.trackers for text in given.split(",") if text]
    if len(trackers) != 1 or not isinstance(trackers[0], Engine):
        raise UsageError("--fit-confidence fits one preset or configuration: name it with --trackers")
    datasets = [_open(folder, args) for folder in args.fit_confidence]
    recorded = []
    with _Bar("fit") as bar:
        for done in record_all(datasets, trackers[0].config, args.jobs, args.backend):
            recorded.append(done)
            bar(len(recorded), sum(map(len, datasets)))
    recorded.sort(key=lambda r: (r.source, r.name))
    sources = sorted({r.source for r in recorded})
    frames = sum(len(r.overlap) for r in recorded)
    title = f"{len(recorded)} sequences of {', '.join(sources)}; {frames} frames, each scored without its data set"
    said = {trackers[0].name: held_out(recorded)}
    print(
        to_markdown(
            [title, ranking(said), statuses(said), absences(said), f"```python\n{constants(fit(recorded))}\n```"]
        )
    )
    return 0


def _keyframes(args: argparse.Namespace) -> int:
    """Print how good the boxes between keyframes are."""
    try:
        distances = [int(n) for n in args.keyframes.split(",")]
    except ValueError:
        distances = []
    if not distances or min(distances) < 2:
        raise UsageError("--keyframes takes numbers of frames from 2 on, as 30,60,120")
    tracker = resolve(args.trackers[0], args.results)
    if len(args.trackers) > 1 or not isinstance(tracker, Engine):
        raise UsageError("--keyframes measures one preset or configuration: name it with --trackers")
    dataset = _dataset(args)
    with _Bar("keyframes") as bar:
        scores = between_keyframes(dataset, distances, tracker.config, args.jobs, bar, args.backend)
    print(to_markdown([f"{dataset.name}, {dataset.coverage} targets", between_table(scores)]))
    return 0


def _dataset(args: argparse.Namespace) -> Dataset:
    for line in misspelt_variables():
        print(f"mfcmt eval: {line}", file=sys.stderr)
    dataset = _open(args.data, args)
    if args.sequences:
        return dataset.select(args.sequences.split(","))
    if dataset.missing:
        print(f"{dataset.coverage} targets; not here: {', '.join(dataset.missing)}", file=sys.stderr)
    return dataset


def _open(folder: Path, args: argparse.Namespace) -> Dataset:
    if not folder.is_dir():
        raise UsageError(f"no data at {folder}: {WANTED}")
    try:
        folder = folder if args.backend == LOCAL else folder.absolute()  # as the machines of a cluster name it
        return open_dataset(folder, args.layout, SUBSETS[args.set])
    except NoData as nothing:
        raise UsageError(f"{nothing}: {WANTED}") from nothing


def _evaluate(
    args: argparse.Namespace, dataset: Dataset, trackers: Seq[Entry | ResultFolder], protocol: str
) -> list[Evaluation]:
    with _Bar(protocol) as bar:
        of_batch = {"jobs": args.jobs, "backend": args.backend, "progress": bar}
        return evaluate(dataset, trackers, protocol, results=args.results, **of_batch)


def _films(args: argparse.Namespace, dataset: Dataset, trackers: list[Entry | ResultFolder]) -> list[Picture]:
    films = []
    for sequence in dataset.select(args.film.split(",")) if args.film else ():
        boxes = {}
        for tracker in trackers:
            with suppress(DataError):  # a missing result is in the report already
                boxes[tracker.name] = boxes_of(tracker, sequence, args.results)
        data = cv2.imencode(".jpg", film.strip(sequence, boxes))[1].tobytes()
        films.append(Picture(f"film_{sequence.name}", f"{sequence.name}: {', '.join(boxes)}", data, "jpg"))
        if args.video:
            args.report.mkdir(parents=True, exist_ok=True)
            film.video(args.report / f"film_{sequence.name}.mp4", sequence, boxes)
    return films


def _complain(trackers: list[Entry | ResultFolder], evaluations: list[Evaluation]) -> bool:
    """Print why scores are missing. Return True if one is of a tracker that ran."""
    ran = {t.name for t in trackers if not isinstance(t, ResultFolder)}
    for e in evaluations:
        for reason in list(e.missing.values())[:3]:
            print(f"{e.tracker}: {reason}", file=sys.stderr)
        if len(e.missing) > 3:
            print(f"{e.tracker}: {len(e.missing)} sequences have no score", file=sys.stderr)
    return any(e.missing and e.tracker in ran for e in evaluations)


class _Bar(Progress):
    """The progress of an evaluation, whose total is known after the first steps."""

    def __init__(self, label: str) -> None:
        super().__init__(None)
        self._label = label
        self._reported = 0

    def __call__(self, done: int, total: int) -> None:
        self.total = total
        self.step(self._label, done - self._reported)
        self._reported = done
