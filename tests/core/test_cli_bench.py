"""``mfcmt bench``: the figures are those of the real tracker, and the clocks leave no trace."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from mfcmt_core import MFCMT, synthetic
from mfcmt_core.cli import UsageError, bench, costs, measure, versus
from tests.commands import run_command


def run(*args: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return run_command("bench", *args, cwd=cwd)


@pytest.fixture(scope="module")
def otb_like(tmp_path_factory) -> Path:
    """A rendered clip in the place of a sequence of OTB: Deer has 71 frames."""
    root = tmp_path_factory.mktemp("otb")
    synthetic.clip("motion", length=71).write(root / "Deer")
    return root


def test_every_stage_is_timed():
    report = bench.measure(measure.synthetic_material("motion", 30), "default", 1)
    for name in ("search window", "template features", "template response", "fusion"):
        assert report["stages_ms"][name]["calls"] >= 0.9, name
        assert report["stages_ms"][name]["median"] > 0
    for name in ("scale features", "scale response", "scale learning"):  # in every second frame
        assert report["stages_ms"][name]["calls"] == pytest.approx(14 / 29), name
        assert report["stages_ms"][name]["mean"] > 0
    assert report["stages_ms"]["everything else"]["calls"] == 1
    assert report["fps"] == pytest.approx(1e3 / report["update_ms"]["mean"])
    assert report["clips"][0]["frames"] == 30


def test_p99_leaves_out_frames_on_which_the_target_is_lost():
    assert measure.spread(np.array([1.0] * 99 + [3.0] * 9)) == pytest.approx(3)
    assert measure.spread(np.empty(0)) is None
    config = MFCMT().config.replace(lost_after=1, tracking_threshold=1.0, lost_threshold=1.0)
    timed = measure.timed_run(MFCMT(config), next(measure.synthetic_material("motion", 4)))
    assert timed.lost.tolist() == [False, True, True, True]
    report = bench.measure(measure.synthetic_material("motion", 30), "default", 1)
    (clip,) = report["clips"]
    assert clip["lost"] == 0
    assert clip["p99_over_median"] >= 1
    assert f"{clip['p99_over_median']:.2f}" in bench.table(report)


@pytest.fixture(scope="module")
def costs_report():
    """What a few frames cost."""
    return costs.measure(MFCMT().config, 4)


def test_costs_have_all_figures(costs_report):
    report = costs_report
    assert set(report["update_ms"]) == {"vga", "full_hd", "lost_vga", "lost_full_hd"}
    assert all(ms > 0 for ms in report["update_ms"].values())
    assert report["targets"]["10"] > report["targets"]["1"] > report["targets"]["decode_ms"] > 0
    if report["cores"]:
        assert report["cores"]["gain"] == pytest.approx(report["cores"]["two"] / report["cores"]["one"])
    text = costs.table(report)
    assert "1920×1080" in text
    assert "10 targets" in text
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_command_prints_costs(costs_report, monkeypatch):
    monkeypatch.setattr(costs, "measure", lambda config, frames: costs_report if frames == 4 else None)
    done = run("--costs", "--frames", 4)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(measure.cpu_name())
    assert "lost, 640×480" in done.stdout


def test_time_in_an_inner_stage_counts_only_there(monkeypatch):
    class Stage:
        def outer(self):
            return [self.inner(), self.inner()]

        def inner(self):
            return "found"

    ticks = iter(range(100))
    monkeypatch.setattr(measure.time, "thread_time", lambda: float(next(ticks)))
    monkeypatch.setattr(measure, "STAGES", (("outer", Stage, "outer"), ("inner", Stage, "inner")))
    clock = measure.StageClock()
    with clock.running():
        assert Stage().outer() == ["found", "found"]
        clock.end_frame()
        clock.end_frame()
    assert clock.seconds == {"outer": [5 - 2, 0], "inner": [2, 0]}
    assert clock.calls == {"outer": [1, 0], "inner": [2, 0]}


def test_clocks_change_no_result_and_are_removed():
    before = [getattr(owner, attribute) for _, owner, attribute in measure.STAGES]
    clip = synthetic.clip("motion", length=120)
    want = [r.box for r in MFCMT().track(clip.frames[:6], clip.boxes[0])]
    clock = measure.StageClock()
    with clock.running():
        assert [r.box for r in MFCMT().track(clip.frames[:6], clip.boxes[0])] == want
    assert [getattr(owner, attribute) for _, owner, attribute in measure.STAGES] == before


def test_command_prints_a_table_with_the_machine():
    done = run("--clip", "small", "--frames", 8, "--repeat", 1)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(measure.cpu_name())
    assert "one thread" in done.stdout
    assert "template features" in done.stdout
    assert "8 frames of 320×240, target 8×8" in done.stdout


def test_command_on_folders_as_json(otb_like):
    done = run("--data", otb_like, "--frames", 6, "--repeat", 1, "--preset", "paper", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    report = json.loads(done.stdout)
    assert report["preset"] == "paper"
    assert report["clips"][0]["name"] == "Deer"
    assert report["clips"][0]["size"] == [320, 240]
    assert report["clips"][0]["update_ms"]["median"] > 0


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--data", "nosuch"), "no folder nosuch"),
        (("--frames", "1"), "--frames"),
        (("--repeat", "0"), "--repeat"),
        (("--core", "4096"), "no core 4096"),
        (("--clip", "small", "--data", "."), "exclude"),
        (("--clip", "nosuch"), "nosuch"),
        (("--costs", "--clip", "small"), "--costs"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_2(args, says, tmp_path):
    done = run(*args, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1


class Slow:
    """Make a peer that takes five times our work, gives up halfway, or cannot start."""

    lives = 10

    def __init__(self) -> None:
        self._trackers = [MFCMT() for _ in range(5)]
        self._count = 0
        self.found = True

    def init(self, image, box):
        for tracker in self._trackers:
            tracker.init(image, box)

    def update(self, image):
        self._count += 1
        self.found = self._count <= self.lives
        if not self.found:
            return (0.0, 0.0, 1.0, 1.0)
        results = [t.update(image) for t in self._trackers]
        return results[0].box


class Dead(Slow):
    lives = 2


class Broken(Slow):
    def init(self, image, box):
        raise RuntimeError("cannot start")


class StubPeer:
    made: ClassVar = {"slow": Slow, "dead": Dead, "broken": Broken, "absent": None}

    def __init__(self, name, peer):
        self.name, self.peer = name, peer
        self.lacks = "something" if self.made[peer] is None else None

    def make(self):
        return self.made[self.peer]()


def test_a_peer_s_speed_counts_only_on_frames_where_it_is_alive(monkeypatch):
    monkeypatch.setattr(versus, "Peer", StubPeer)
    monkeypatch.setattr(versus, "PEERS", tuple(StubPeer.made))
    monkeypatch.setattr(versus, "FEWEST", 5)
    report = versus.measure(measure.synthetic_material("motion", 20), "default")
    rows = {row["name"]: row for row in report["trackers"]}
    assert set(rows) == {"MFCMT", "slow", "dead", "broken"}
    assert rows["MFCMT"]["times_ours"] == 1
    medians = report["median_ms"]["motion"]
    assert rows["slow"]["times_ours"] == pytest.approx(medians["slow"] / medians["MFCMT"])
    assert rows["slow"]["times_ours"] > 1
    assert medians["dead"] is None
    assert rows["slow"]["alive"] == pytest.approx(10 / 19)
    assert rows["slow"]["auc"] < rows["MFCMT"]["auc"]  # boxes on frames without the target count for accuracy
    assert rows["dead"]["timed"] == 0
    assert "times_ours" not in rows["dead"]
    assert "auc" not in rows["broken"]
    assert sorted(report["left_out"]) == [
        "absent: needs something",
        "broken on motion: RuntimeError",
        "speed of dead on motion: alive on 2 of 19 frames",
    ]
    assert report["p99_over_median"]["motion"] >= 1
    text = versus.table(report)
    assert "slower than a peer on:\n  none" in text
    assert "left out:" in text
    assert "absent: needs something" in text
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_without_peers_the_command_tells_how_to_install_them(monkeypatch):
    monkeypatch.setattr(versus, "Peer", StubPeer)
    monkeypatch.setattr(versus, "PEERS", ("absent",))
    with pytest.raises(UsageError, match="make bench-peers"):
        versus.measure(iter(()), "default")


def test_time_is_processor_time():
    class Sleeper:
        def init(self, image, box):
            pass

        def update(self, image):
            import time

            time.sleep(0.02)
            return (0.0, 0.0, 1.0, 1.0)

    item = next(measure.synthetic_material("small", 4))
    timed = measure.timed_run(Sleeper(), item)
    assert (timed.wall[1:] > 0.019).all()
    assert np.median(timed.cpu[1:]) < 0.01
    assert timed.alive.all()
