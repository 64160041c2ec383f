"""``mfcmt eval`` from the outside."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from mfcmt_core import synthetic
from mfcmt_core.cli import main
from mfcmt_core.confidence import DEFAULT


def test_eval_prints_the_scores_of_published_boxes(
    annotations: Path, published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [str(published / n) for n in ("MCCT-H", "Struck")]
    command = ["eval", "--data", str(annotations), "--results", str(tmp_path), "--trackers", *folders]
    assert main([*command, "--set", "otb2013"]) == 0
    out = capsys.readouterr().out
    assert "OTB-2013 OPE, 51 targets" in out
    assert "| Struck | 0.474 | 0.656 |" in out
    assert main(command) == 0
    captured = capsys.readouterr()
    assert "| MCCT-H | 0.633 | 0.842 |" in captured.out
    assert "has no ClifBar.txt" in captured.err


def test_eval_writes_results_a_report_and_a_film(
    otb_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["eval", "--data", str(otb_root), "--results", str(tmp_path / "results"), "--jobs", "1"]
    command += ["--sequences", "Deer", "--trackers", "default,paper", "--report", str(tmp_path / "report")]
    command += ["--trust"]
    assert main([*command, "--film", "Deer"]) == 0
    captured = capsys.readouterr()
    assert "| tracker | AUROC | caught at 5% | calibration error | targets |" in captured.out
    assert "| tracker | right: tracking | right: uncertain | right: lost |" in captured.out
    for plot in ("reliability", "risk"):
        assert "<svg" in (tmp_path / "report" / f"ope_{plot}.svg").read_text()
    assert captured.err == ""  # no progress bar where there is no terminal
    assert (tmp_path / "results" / "OPE" / "default" / "Deer.txt").read_text().startswith("306.000,5.000,")
    assert (tmp_path / "report" / "film_Deer.jpg").stat().st_size > 10_000
    assert "data:image/jpeg;base64," in (tmp_path / "report" / "report.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--data", "nowhere"], 2, "no data at nowhere: name a folder of sequences with --data or MFCMT_OTB_ROOT"),
        (["--data", "."], 2, "is here: name a folder of sequences with --data or MFCMT_OTB_ROOT"),
        (["--protocol", "xpe"], 2, "unknown protocol: XPE"),
        (["--film", "Deer"], 2, "--film"),
        (["--trackers", "best"], 1, "no tracker 'best'"),
        (["--sequences", "Deer,Nothing"], 1, "has no Nothing"),
    ],
)
def test_bad_arguments_are_refused_and_leave_no_file(
    annotations: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["eval", "--data", str(annotations.resolve()), *arguments]) == code
    assert says in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_tracker_needs_images(annotations: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", "--data", str(annotations), "--results", str(tmp_path)]) == 1
    assert "has no images for default" in capsys.readouterr().err


def test_ctrl_c_keeps_what_is_done_and_leaves_no_process(otb_root: Path, tmp_path: Path) -> None:
    command = [str(Path(sys.executable).with_name("mfcmt")), "eval", "--data", str(otb_root), "--jobs", "2"]
    command += [
        "--results",
        str(tmp_path),
        "--trackers",
        "default,paper",
        "--sequences",
        "Dog1,Car1,Suv,Girl",
    ]
    child = subprocess.Popen(
        command,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # A shell's background job, which these tests may be, passes on that Ctrl-C is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        wait_for(lambda: list(tmp_path.rglob("*.json")) or child.poll() is not None, 120)
        os.killpg(child.pid, signal.SIGINT)
        said = child.communicate(timeout=30)[1]
    finally:
        child.kill()
    assert child.returncode == 130
    assert b"Traceback" not in said
    assert 0 < len(list(tmp_path.rglob("*.json"))) < 8
    assert not list(tmp_path.rglob("*.part"))
    assert wait_for(lambda: not alive(child.pid), 10)


def wait_for(condition: Callable[[], object], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not (met := bool(condition())) and time.monotonic() < deadline:
        time.sleep(0.05)
    return met


def alive(group: int) -> bool:
    """Whether any process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_the_confidence_is_fitted_to_folders_of_videos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for source, name in (("one", "motion"), ("other", "occlusion")):
        clip = synthetic.clip(name, length=60)
        height, width = clip.frames[0].shape[:2]
        path = tmp_path / f"{source}-{name}.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (width, height))
        for frame in clip.frames:
            writer.write(frame)
        writer.release()
        lines = (",".join(map(str, box)) for box in clip.boxes[: len(clip.frames)])
        path.with_suffix(".txt").write_text("\n".join(lines) + "\n")
    assert main(["eval", "--fit-confidence", str(tmp_path), "--jobs", "1"]) == 0
    out = capsys.readouterr().out
    assert "2 sequences of one, other; " in out
    assert "each scored without its data set" in out
    assert all(f'"{name}": ' in out for name in DEFAULT.weights)


def test_one_tracker_is_fitted_at_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", "--fit-confidence", str(tmp_path), "--trackers", "default,paper"]) == 2
    assert "name it with --trackers" in capsys.readouterr().err
