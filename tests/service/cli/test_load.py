"""``mfcmt load`` and ``mfcmt demo`` as they are typed, against servers of their own."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from mfcmt_core import synthetic
from mfcmt_core.cli import main
from mfcmt_core.cli.measure import cpu_name
from service.load import table
from service.load.clips import Clip, open_clip
from service.load.drive import Pace
from service.load.own import OwnServer
from service.load.regions import savings, small_target_clip
from service.load.report import Goal, Report
from service.load.run import load, run_loop
from service.load.text import of_report
from service.load.usage import server_processes, server_usage


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered sequence, stored as OTB does."""
    place = tmp_path_factory.mktemp("sequence")
    synthetic.clip("motion", length=12).write(place)
    return place


def test_load_prints_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["load", "--frames", str(folder), "--sessions", "2", "--seconds", "0.5", "--fps", "40", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["sessions"] == 2
    assert report["sent"] == report["answered"] + report["dropped"]
    assert 0 < report["p50_ms"] <= report["p95_ms"] <= report["p99_ms"]
    assert {"front", "fork server", "lane 0"} <= set(report["after"])
    assert report["after"]["lane 0"]["rss_bytes"] > 10_000_000


def test_load_drives_a_given_server(server: OwnServer, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--url", server.url, "--frames", str(folder), "--seconds", "0.5", "--fps", "0", "--protocol", "json"]
    assert main(["load", *arguments]) == 0
    out = capsys.readouterr().out
    assert "frames/s" in out
    assert "round trip  p50" in out


def test_the_table_has_a_row_for_each_kind_of_frames(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(table, "SIZES", {"320×240": (320, 240)})
    assert main(["load", "--table", "--seconds", "0.3", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["cpu"]
    assert [row["kind"] for row in report["rows"]] == [asdict(kind) for kind in table.KINDS]
    for row in report["rows"]:
        assert min(row["front_ms"], row["lane_ms"], row["decode_ms"], row["track_ms"], row["streams"]) >= 0
        assert row["bound"] in ("front", "decode", "track")
    whole, regions = report["rows"][1], report["rows"][4]
    assert whole["kind"] | {"regions": True} == regions["kind"]
    assert regions["frame_bytes"] < whole["frame_bytes"]


def test_the_table_is_markdown() -> None:
    text = table.of_table([table.Row("640×480", table.Kind(False, 75, 1), 5e4, 0.2, 0.8, 0.3, 0.4)])
    head, _, *lines = text.splitlines()
    assert cpu_name() in head
    assert {line.count("|") for line in lines} == {8}
    assert "| 33 | track |" in lines[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        ["--url", "http://192.0.2.1:8000"],
        ["--url", "ftp://127.0.0.1"],
        ["--sessions", "0"],
        ["--seconds", "1e9"],
        ["--fps", "-1"],
        ["--fps", "0", "--mode", "latest"],
        ["--size", "640"],
        ["--box", "1,2,3"],
        ["--frames", "no/such/folder"],
        ["--url", "http://127.0.0.1:1", "--report"],
        ["--url", "http://127.0.0.1:1", "--table"],
        ["--table", "--report"],
        ["--table", "--size", "640x480"],
        ["--url", "ws://127.0.0.1:1"],
        ["--url", "http://127.0.0.1:1", "--key", "two words"],
    ],
)
def test_load_refuses_what_does_not_fit(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["load", *arguments]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_load_without_a_server(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["load", "--url", "http://127.0.0.1:1", "--seconds", "1"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_demo_prints_lines_in_a_pipe(server: OwnServer, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--terminal", str(folder), "--url", server.url, "--fps", "200", "--mode", "lossless"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 11 + 1
    assert lines[1].startswith("frame    1  box")
    assert "11 results" in lines[-1]


def test_demo_of_the_rendered_clip(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--terminal", "--frames", "10", "--fps", "60"]) == 0
    assert "results in" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [["--frames", "1"], ["--fps", "0"], ["no/such/video.mp4"], ["--box", "x"], ["--url", "ws://x"]]
)
def test_demo_refuses_what_does_not_fit(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--terminal", *arguments]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("arguments", [["--box", "1,2,3,4"], ["--port", "70000"], ["folder"]])
def test_the_page_of_the_demo_takes_no_source(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--no-browser", *arguments]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_clip_runs_there_and_back() -> None:
    clip = Clip("c", [b"0", b"1", b"2"], (0, 0, 1, 1))
    assert b"".join(clip.frame(i) for i in range(9)) == b"012101210"
    assert Clip("c", [b"0"], (0, 0, 1, 1)).frame(5) == b"0"


def test_clips_take_the_ground_truth(folder: Path) -> None:
    truth = synthetic.clip("motion", length=12).boxes[0]
    clip = open_clip(folder, None)
    assert clip.box == pytest.approx(tuple(truth), abs=1e-3)
    larger = clip.resized((640, 480))
    assert larger.size == (640, 480)
    assert larger.box == pytest.approx(tuple(2 * truth), abs=2e-3)


def test_usage_knows_the_processes(server: OwnServer) -> None:
    assert set(server_processes(server.pid)) == {"front", "fork server", "lane 0", "lane 1"}
    before = server_usage(server.pid)
    clip = small_target_clip(3)
    run = run_loop(load(server.url, clip, [Pace(0.3, in_flight=1)], front=server.pid))[0]
    assert run.lanes_cpu_ms is not None
    assert all(now.cpu_s >= before[role].cpu_s for role, now in server_usage(server.pid).items())


def test_savings_of_regions() -> None:
    small, rendered = savings([small_target_clip(8)], 2)
    assert small.frames == rendered.frames == 3
    assert 0 < small.p50 < 0.4


def test_a_missed_target_is_told() -> None:
    report = Report(targets=[Goal("a", 1.0, 2.0, "x"), Goal("b", 1.0, 2.0, "x", at_least=True)])
    assert [one["met"] for one in report.as_dict()["targets"]] == [True, False]
    lines = of_report(report, small_target_clip(2)).splitlines()
    assert lines[-2].endswith("<= 2     met")
    assert lines[-1].endswith(">= 2     MISSED")
