"""Section IV of the paper again: the comparison, and its claims one by one against ablations."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Seq
from dataclasses import dataclass
from pathlib import Path

from ..config import PRESETS
from ..errors import DataError
from .catalogue import ABLATIONS, CHOICES, SYSTEMS, resolve
from .compare import Difference, compare
from .dataset import Dataset
from .document import Block, Heading, Strong, Table, to_markdown
from .peers import PEERS
from .report import Results, machine, write_report
from .score import Evaluation
from .tables import summary
from .trackers import Entry, ResultFolder

PAPER_FPS = 63
"""Of the paper's MATLAB code on an Intel i5-4590 at 3.3 GHz."""


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper and the trackers that a preset must beat for it to hold.

    An opponent that begins with ``-`` is an ablation of the preset itself.
    """

    text: str
    where: str
    opponents: tuple[str, ...]


CLAIMS = (
    Claim(
        "The ensemble is better than each of its single models.",
        "sections I and III-B",
        ("-gray", "-fhog", "-color-names", "-histogram"),
    ),
    Claim(
        "Template and colour histogram complement each other: without the histogram it is worse.",
        "section II-C",
        ("-no-histogram",),
    ),
    Claim(
        "Fusion by relative entropy is better than Staple's fixed factor.",
        "sections II-C and III-B",
        ("-fixed-merge",),
    ),
    Claim(
        "Updating only on reliable frames is better than always updating.",
        "section III-C",
        ("-always-update",),
    ),
    Claim(
        "Estimating the scale only on reliable frames is better than always.",
        "section III-C",
        ("-always-scale",),
    ),
    Claim("Estimating the scale pays.", "Algorithm 1, line 8", ("-no-scale",)),
    Claim(
        "It is better than the trackers it builds on and than its rivals.",
        "section IV-B",
        ("staple", "samf", "dsst", "kcf", "MEEM", "KCF", "DSST", "SAMF", "Struck", "Staple"),
    ),
)

Run = Callable[[Seq[Entry | ResultFolder], str], list[Evaluation]]
"""Runs trackers under a protocol."""


def comparison(results: Path, published: Path | None) -> list[Entry | ResultFolder]:
    """Return the presets, the rivals from our engine, the peers that are there, and the published boxes."""
    trackers: list[Entry | ResultFolder] = [resolve(name) for name in (*PRESETS, *SYSTEMS) if name != "dcf"]
    for peer in PEERS:
        try:
            trackers.append(resolve(peer, results))
        except DataError:
            continue  # neither its library nor results of it are here
    if published is not None:
        trackers += [ResultFolder(p.name, p) for p in sorted(published.iterdir()) if p.is_dir()]
    return trackers


def ablations() -> list[Entry | ResultFolder]:
    """Return each preset with one part taken away or one left, and ``default`` with each choice taken back."""
    names = [f"{preset}-{name}" for preset in PRESETS for name in ABLATIONS]
    return [resolve(name) for name in (*names, *(f"default-{choice}" for choice in CHOICES))]


def reproduce(
    folder: Path, dataset: Dataset, protocols: Seq[str], results: Path, published: Path | None, run: Run
) -> None:
    """Run what is not finished and write the pages: ``report.*`` for the comparison, ``claims.md``."""
    compared = comparison(results, published)
    reported: Results = {}
    everything: Results = {}
    for protocol in protocols:
        reported[protocol] = run(compared, protocol)
        everything[protocol] = reported[protocol] + run(ablations(), protocol)
    write_report(folder, dataset, reported, command="make reproduce DATA=...")
    (folder / "claims.md").write_text(to_markdown(claims_page(dataset, everything)), encoding="utf-8")


def claims_page(dataset: Dataset, results: Results) -> list[Block]:
    """Return, claim by claim, what the ablations show, also if a claim does not hold."""
    blocks: list[Block] = [
        Heading("The claims of the paper, measured", 1),
        f"{dataset.name}, {dataset.coverage} targets; made by `make reproduce`. Measured with "
        + ", ".join(f"{k} {v}" for k, v in machine().items())
        + ".",
        "A difference is the preset's success minus the other's, with its paired 95 % bootstrap interval over the "
        "targets. A claim **holds** where the whole interval is above 0, **does not hold** where it is below, and "
        "is **not decided** otherwise. Trackers in capitals are published boxes (OPE only), in lower case "
        "configurations of our own engine. The numbers of `default` were chosen on OTB sequences, so what it wins "
        "here is an upper bound; those of `paper` are the paper's.",
    ]
    for claim in CLAIMS:
        table = _table(PRESETS, claim.opponents, results)
        if table.rows:
            blocks += [Heading(claim.text), f"The paper: {claim.where}.", table]
    blocks.append(Heading(f"It runs at {PAPER_FPS} frames a second (MATLAB, i5-4590)."))
    for protocol, evaluations in results.items():
        own = [e for e in evaluations if e.tracker in PRESETS]
        blocks += [f"{protocol}, decoding not counted:", summary(own, dataset)]
    choices = _table(("default",), tuple(f"-{choice}" for choice in CHOICES), results)
    if choices.rows:
        blocks += [Heading("What `default` does differently"), "Each choice taken back alone.", choices]
    return blocks


def _table(presets: Seq[str], opponents: Seq[str], results: Results) -> Table:
    rows = [
        row
        for preset in presets
        for opponent in opponents
        for protocol, evaluations in results.items()
        if (row := _row(preset, opponent, protocol, evaluations)) is not None
    ]
    return Table(["preset", "against", "protocol", "difference in success", "better / even / worse", "verdict"], rows)


def _row(preset: str, opponent: str, protocol: str, evaluations: list[Evaluation]) -> list[str] | None:
    by_name = {e.tracker: e for e in evaluations if e.scores}
    other = preset + opponent if opponent.startswith("-") else opponent
    if preset not in by_name or other not in by_name:
        return None
    d = compare(by_name[preset], by_name[other])
    counts = f"{d.won} / {d.sequences - d.won - d.lost} / {d.lost}"
    return [preset, other, protocol, f"{d.mean:+.3f} [{d.low:+.3f}, {d.high:+.3f}]", counts, _verdict(d)]


def _verdict(d: Difference) -> str:
    if not d.is_evidence:
        return "not decided"
    return Strong("holds" if d.low > 0 else "does not hold")
