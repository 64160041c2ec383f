"""Reports: the numbers in them, the forms they take, and what they say about missing results."""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Sequence as Seq
from pathlib import Path

import numpy as np
import pytest

from mfcmt_core.otb import DataError, Dataset, Entry, Evaluation, ResultFolder, evaluate
from mfcmt_core.otb.compare import compare
from mfcmt_core.otb.document import Heading, Picture, Strong, Table, to_html, to_markdown
from mfcmt_core.otb.report import write_report
from mfcmt_core.otb.reproduce import claims_page, reproduce
from mfcmt_core.otb.tables import attributes, differences, per_sequence, published_figures, summary


@pytest.fixture(scope="module")
def evaluations(otb2015: Dataset, published: Path) -> list[Evaluation]:
    names = ["MCCT-H", "SRDCF", "Struck", "DSST", "Staple"]
    return evaluate(otb2015, [ResultFolder(n, published / n) for n in names])


def test_the_summary_ranks_and_keeps_incomplete_trackers_apart(evaluations: list[Evaluation], otb2015: Dataset) -> None:
    table = summary(evaluations, otb2015)
    assert [row[0] for row in table.rows] == ["MCCT-H", "SRDCF", "DSST", "Staple", "Struck"]
    assert table.header[-1] == "success on the 25 of all"
    assert table.rows[0][1:3] == ["0.633", "0.842"]
    assert table.rows[3][7] == "25 of 100"
    assert table.rows[4][7] == "99 of 100"


def test_attribute_scores_are_means_over_the_targets_that_have_it(
    evaluations: list[Evaluation], otb2015: Dataset
) -> None:
    table = attributes(evaluations, otb2015)
    assert table.header[1] == "IV (38)"
    assert len(table.header) == 12
    names = [s.name for s in otb2015 if "OCC" in s.attributes]
    row = next(r for r in table.rows if r[0] == "MCCT-H")
    column = table.header.index(f"OCC ({len(names)})")
    assert row[column] == f"{np.mean([evaluations[0].scores[n].success for n in names]):.3f}"


def test_differences_have_intervals_and_counts(evaluations: list[Evaluation]) -> None:
    d = compare(evaluations[0], evaluations[1])
    assert d.low < d.mean < d.high
    assert d.mean == pytest.approx(evaluations[0].success - evaluations[1].success)
    assert d.is_evidence
    assert compare(evaluations[0], evaluations[1]) == d  # seeded
    same = compare(evaluations[0], evaluations[0])
    assert (same.mean, same.won, same.lost, same.is_evidence) == (0, 0, 0, False)
    assert compare(evaluations[0], evaluations[4]).sequences == 25
    table = differences(evaluations)
    assert [row[0] for row in table.rows] == ["SRDCF", "Struck", "DSST", "Staple"]
    assert isinstance(table.rows[0][1], Strong)
    with pytest.raises(DataError, match="no sequence in common"):
        compare(evaluations[0], Evaluation("none", "OPE", {}))


def test_the_interval_covers_what_it_should() -> None:
    """Of 200 samples of pure noise about one in twenty intervals leaves out the true mean of 0."""
    from mfcmt_core.otb import SequenceScore

    random = np.random.default_rng(1)

    def noise() -> Evaluation:
        curves = random.normal(0.5, 0.1, size=(40, 21))
        scores = {str(i): SequenceScore(c, c, c, 10) for i, c in enumerate(curves)}
        return Evaluation("noise", "OPE", scores)

    wrong = sum(compare(noise(), noise(), samples=1000).is_evidence for _ in range(200))
    assert 2 <= wrong <= 24


def test_per_sequence_table_shows_gaps(evaluations: list[Evaluation], otb2015: Dataset) -> None:
    row = next(r for r in per_sequence(evaluations, otb2015).rows if r[0] == "ClifBar")
    assert row[1] == "472"
    assert row[4] == "–"


def test_published_figures_are_cited(otb2015: Dataset) -> None:
    rows = {row[0]: row for row in published_figures("OTB-2015").rows}
    assert rows["DLSSVM"][1] == "0.541"
    assert rows["MFCMT"][3] == "63"
    assert all(row[-1] for row in rows.values())


def test_the_report_has_its_page_plots_and_scores_as_files(
    tmp_path: Path, evaluations: list[Evaluation], otb2015: Dataset
) -> None:
    pytest.importorskip("matplotlib")
    write_report(tmp_path, otb2015, {"OPE": evaluations}, command="mfcmt eval --x <y>")
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 4
    assert "<y>" not in page
    assert 'src="http' not in page
    assert "ClifBar" in page
    text = (tmp_path / "report.md").read_text()
    for plot in ("ope_success", "ope_precision", "ope_norm_precision", "ope_attributes"):
        assert f"({plot}.svg)" in text
        assert (tmp_path / f"{plot}.svg").read_text().startswith("<?xml")
    assert "MCCT-H [0.633]" in (tmp_path / "ope_success.svg").read_text()
    rows = list(csv.DictReader((tmp_path / "scores.csv").read_text().splitlines()))
    assert len(rows) == 500
    assert sum(bool(r["missing"]) for r in rows) == 76
    data = json.loads((tmp_path / "scores.json").read_text())
    first = data["protocols"]["OPE"][0]
    assert first["success"] == pytest.approx(0.6333, abs=1e-4)
    assert len(first["sequences"]["David"]["success_curve"]) == 21


def test_claims_are_judged_by_their_intervals(evaluations: list[Evaluation], otb2015: Dataset) -> None:
    better, worse = (e.scores for e in evaluations[:2])
    results = [
        Evaluation("default", "OPE", better),
        Evaluation("default-no-scale", "OPE", worse),
        Evaluation("default-always-update", "OPE", better),
        Evaluation("paper", "OPE", worse),
        Evaluation("paper-always-update", "OPE", better),
        Evaluation("MEEM", "OPE", {}),
    ]
    tables = {b.text: t for b, t in itertools.pairwise(blocks(results, otb2015)) if isinstance(t, Table)}
    assert [row[-1] for row in tables["Estimating the scale pays."].rows] == ["holds"]
    verdicts = [row[-1] for row in tables["Updating only on reliable frames is better than always updating."].rows]
    assert verdicts == ["not decided", "does not hold"]
    assert len(tables) == 2


def blocks(results: list[Evaluation], dataset: Dataset) -> list[Heading | Table]:
    return [b for b in claims_page(dataset, {"OPE": results}) if isinstance(b, Heading | Table)][:-1]


def test_everything_is_reproduced(
    tmp_path: Path, evaluations: list[Evaluation], otb2015: Dataset, published: Path
) -> None:
    asked: list[str] = []

    def run(trackers: Seq[Entry | ResultFolder], protocol: str) -> list[Evaluation]:
        asked.extend(t.name for t in trackers)
        return [Evaluation(t.name, protocol, evaluations[i % 2].scores) for i, t in enumerate(trackers)]

    (tmp_path / "results" / "OPE" / "dlib").mkdir(parents=True)
    reproduce(tmp_path / "pages", otb2015, ["OPE"], tmp_path / "results", published, run)
    assert len(asked) == len(set(asked))
    wanted = {"default", "paper", "staple", "dat", "dlib", "MEEM", "paper-always-update", "default-clipped"}
    assert wanted <= set(asked)
    assert {p.name for p in (tmp_path / "pages").iterdir()} >= {"report.md", "report.html", "claims.md"}
    assert "default-fixed-merge" in (tmp_path / "pages" / "claims.md").read_text()


def test_the_same_scores_give_the_same_files(tmp_path: Path, evaluations: list[Evaluation], otb2015: Dataset) -> None:
    pytest.importorskip("matplotlib")
    for name in ("a", "b"):
        write_report(tmp_path / name, otb2015, {"OPE": evaluations})
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_markdown_and_html_escape_what_they_must() -> None:
    blocks = [Heading("A & B", 1), "x < y", Table(["a|b"], [[Strong("1|2")]]), Picture("p", "P", b"<svg/>")]
    assert to_markdown(blocks) == "# A & B\n\nx < y\n\n| a\\|b |\n| --- |\n| **1\\|2** |\n\n![P](p.svg)\n"
    page = to_html("A & B", blocks)
    assert "<h1>A &amp; B</h1>" in page
    assert "<p>x &lt; y</p>" in page
    assert "<td><b>1|2</b></td>" in page
