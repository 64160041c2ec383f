"""Each fault of nodes and of Redis once, under streams of both clients; the long form is ``mfcmt chaos --cluster``."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest

from mfcmt_core.cli import main
from service.load.clips import Clip
from tests.conftest import require
from tests.tools.chaos import cluster_lines
from tests.tools.chaos.cluster import FAULTS, ClusterPlan, ClusterReport, cluster_chaos


def test_no_session_and_no_result_is_lost_doubled_or_different(clip: Clip) -> None:
    for program in ("haproxy", "node"):
        require(shutil.which(program), f"no {program}")
    report = cluster_chaos(clip, ClusterPlan(sessions=4, fps=5, rounds=1, seed=1), print)
    assert report.sessions_lost == []
    assert (report.lost, report.doubled, report.refused, report.differ) == (0, 0, {}, 0)
    assert report.flawless
    assert report.compared > 40
    assert {*report.pauses} == {*FAULTS}


def test_what_the_command_says_of_a_cluster() -> None:
    plan = ClusterPlan(30, 10, 1, 1)
    report = ClusterReport(plan, 900, 0, 0, {}, 800, 0, [], {"kill": [7.5], "drain": [0.4]}, 10)
    printed = "\n".join(cluster_lines(report, "sample"))
    assert "results lost       0 of 900" in printed
    assert "results doubled    0" in printed
    assert "results that differ    0 of 800" in printed
    assert "sessions lost      0" in printed
    assert "kill               longest pause of a stream 7.5 s" in printed
    assert json.loads(json.dumps(report.as_dict()))["lost"] == 0
    for wrong in (
        {"lost": 1},
        {"doubled": 1},
        {"differ": 1},
        {"sessions_lost": ["gone"]},
        {"refused": {"draining": 1}},
    ):
        assert not replace(report, **wrong).flawless


def test_bad_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["chaos", "--cluster", "--rounds", "0"]) == 2
    assert "--rounds" in capsys.readouterr().err
