"""Faults at random moments under ten streams; the long form is ``mfcmt chaos``."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from mfcmt_core.cli import main
from service.load.clips import Clip
from tests.tools.chaos import lines
from tests.tools.chaos.run import IDLE_S, LANE_FAULTS, RESTARTS, Plan, Report, chaos


def test_nothing_is_lost_and_nothing_differs(clip: Clip) -> None:
    """A lane is killed, stopped and made to grow, the service stopped and killed: every result comes."""
    plan = Plan(sessions=10, fps=15, lanes=2, faults=3, restarts=1, seed=7)
    report = chaos(clip, plan, print)
    assert report.faults == dict.fromkeys((*LANE_FAULTS, *RESTARTS), 1)
    assert [len(report.seconds[kind]) for kind in RESTARTS] == [10, 10]
    assert all(1 <= len(report.seconds[kind]) <= 10 for kind in LANE_FAULTS)
    assert report.frames > 100
    assert report.compared > 100
    assert (report.lost, report.refused, report.differ) == (0, {}, 0)
    assert report.flawless
    assert report.age_s > IDLE_S
    assert len(report.forgotten) <= 10
    assert all(0 <= count <= 60 for count in report.forgotten)


def test_what_the_command_says() -> None:
    seconds = {"SIGKILL": [0.12, 0.2], "SIGTERM": [3.0]}
    report = Report(Plan(10, 30, 2, 2, 1, 1), {"SIGKILL": 2, "SIGTERM": 1}, seconds, 500, 0, {}, 400, 0, [12], 11.2)
    printed = "\n".join(lines(report, "sample"))
    assert "results lost       0 of 500" in printed
    assert "boxes that differ  0 of 400" in printed
    assert "SIGKILL to next result  median    160 ms, max    200 ms" in printed
    assert "SIGTERM to resumed" in printed
    assert "at most 12 frames" in printed
    assert "every session was 11 s old at the first restart" in printed
    assert json.loads(json.dumps(report.as_dict()))["lost"] == 0
    assert not replace(report, differ=1).flawless
    assert "1 refused with at-capacity" in "\n".join(lines(replace(report, refused={"at-capacity": 1}), "sample"))


@pytest.mark.parametrize("wrong", [["--faults", "-1"], ["--sessions", "0"], ["--fps", "1e9"]])
def test_bad_arguments(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["chaos", *wrong]) == 2
    assert wrong[0] in capsys.readouterr().err
