"""``mfcmt track`` on folders and on a video: its results, its messages and its exit codes."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core import MFCMT, MFCMTConfig, TrackResult, synthetic
from mfcmt_core.cli import main
from mfcmt_core.cli.media import Source
from mfcmt_core.video import Frame
from tests.commands import run_command

SCRIPT = Path(sys.executable).with_name("mfcmt")
LENGTH = 20


def track(*args: object, **kwargs: object) -> subprocess.CompletedProcess[str]:
    return run_command("track", *args, **kwargs)


def track_as_typed(*args: object) -> subprocess.CompletedProcess[str]:
    """Run the console script in a process of its own."""
    words = [str(SCRIPT), "track", *map(str, args)]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)


def one_based(results: list[TrackResult]) -> np.ndarray:
    return np.array([r.box for r in results]) + np.array([1, 1, 0, 0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Write a folder like OTB's, with images in ``img`` whose names have no leading zeros."""
    path = tmp_path_factory.mktemp("clip") / "Clip"
    (path / "img").mkdir(parents=True)
    for i, frame in enumerate(synthetic.clip("motion").frames[:LENGTH], 1):
        cv2.imwrite(str(path / "img" / f"{i}.png"), frame)
    return path


@pytest.fixture(scope="module")
def truth(clip):
    """Return the library's results for these frames."""
    return list(MFCMT().track(clip.frames[:LENGTH], clip.boxes[0]))


def test_csv_is_the_default_and_equals_the_library(folder, box, truth):
    done = track_as_typed(folder, "--box", box)
    assert (done.returncode, done.stderr) == (0, "")
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    assert [int(r["frame"]) for r in rows] == list(range(LENGTH))
    for row, result in zip(rows, truth, strict=True):
        assert [float(row[k]) for k in "xywh"] == pytest.approx(result.box, rel=1e-9)
        assert (row["status"], row["target"], row["time_s"]) == (result.status, "target", "")
        assert row["updated"] == str(result.updated).lower()
        assert float(row["scale"]) == pytest.approx(result.scale)
        assert float(row["confidence"]) == pytest.approx(result.confidence)
        if result.scores:
            assert float(row["template"]) == pytest.approx(result.scores.template)
            assert row["reliable"] == str(result.reliable).lower()
        else:
            assert row["fused"] == row["psr"] == row["reliable"] == ""


def test_json_lines_carry_the_whole_result(folder, box, truth):
    done = track(folder / "img", "--box", box, "--format", "jsonl")
    assert (done.returncode, done.stderr) == (0, "")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines) == LENGTH
    for i, (line, result) in enumerate(zip(lines, truth, strict=True)):
        assert line["frame"] == i
        assert tuple(line["box"]) == result.box
        assert line["status"] == result.status
        assert set(line) == {
            "frame",
            "time_s",
            "target",
            "box",
            "status",
            "reliable",
            "flags",
            "scores",
            "psr",
            "updated",
            "scale",
            "confidence",
        }
        if result.flags and result.scores:
            assert line["flags"]["statistical"] == result.flags.statistical
            assert line["scores"]["fused"] == result.scores.fused


def test_otb_text_is_one_based(folder, box, truth, tmp_path):
    done = track(folder, "--box", box, "--output", tmp_path / "Clip.txt")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    boxes = np.loadtxt(tmp_path / "Clip.txt", delimiter=",")
    assert boxes == pytest.approx(one_based(truth), abs=6e-4)


def test_mot_lines_are_one_based_and_have_a_confidence(folder, box, truth):
    done = track(folder, "--box", box, "--format", "mot")
    rows = np.loadtxt(io.StringIO(done.stdout), delimiter=",")
    assert rows.shape == (LENGTH, 10)
    assert rows[:, 0].tolist() == list(range(1, LENGTH + 1))
    assert (rows[:, 1] == 1).all()
    assert rows[:, 2:6] == pytest.approx(one_based(truth), abs=6e-4)
    assert rows[:, 6] == pytest.approx([r.confidence for r in truth], abs=6e-5)
    assert (rows[:, 7:] == -1).all()


def test_video_in_and_annotated_video_out(clip, box, tmp_path):
    source = tmp_path / "in.avi"
    writer = cv2.VideoWriter(str(source), cv2.VideoWriter.fourcc(*"MJPG"), 25, (320, 240))
    for frame in clip.frames[:LENGTH]:
        writer.write(frame)
    writer.release()
    for suffix in (".mp4", ".webm"):
        out = tmp_path / f"out{suffix}"
        done = track_as_typed(source, "--box", box, "--video", out)
        assert (done.returncode, done.stderr) == (0, "")
        assert len(done.stdout.splitlines()) == LENGTH + 1
        capture = cv2.VideoCapture(str(out))
        assert capture.get(cv2.CAP_PROP_FPS) == 25
        frames = []
        while (read := capture.read())[0]:
            frames.append(read[1])
        assert len(frames) == LENGTH
        assert frames[0].shape[1] == 320
        assert frames[0].shape[0] > 240  # the strip
        x, y, w, _ = clip.boxes[0]
        edge = frames[0][round(y), round(x + w / 4) : round(x + 3 * w / 4)].mean(axis=0)
        assert edge[1] > edge[0]  # the box is drawn, and in green
        assert edge[1] > edge[2]


def test_preset_and_config_reach_the_tracker(folder, box, clip, tmp_path):
    want = list(MFCMT(MFCMTConfig.paper()).track(clip.frames[:LENGTH], clip.boxes[0]))[-1]
    done = track(folder, "--box", box, "--preset", "paper", "--format", "jsonl")
    assert tuple(json.loads(done.stdout.splitlines()[-1])["box"]) == want.box
    (tmp_path / "c.toml").write_text('base = "paper"\nnum_scales = 1\n')
    done = track(folder, "--box", box, "--config", tmp_path / "c.toml", "--format", "jsonl")
    assert {json.loads(line)["scale"] for line in done.stdout.splitlines()} == {1.0}
    for wrong in ('{"nosuch": 1}', '{"num_scales": 2}', "[]", "{"):
        (tmp_path / "c.json").write_text(wrong)
        done = track(folder, "--box", box, "--config", tmp_path / "c.json")
        assert done.returncode == 2, wrong
        assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("nosuch", "--box", "1,2,3,4"), "no folder, video file or camera: nosuch"),
        (("{}", "--box", "1,2,3"), "four numbers"),
        (("{}", "--box", "1,2,nan,4"), "no area"),
        (("{}", "--box", "1,2,0,4"), "no area"),
        (("{}", "--box", "1", "2", "3"), "four numbers"),
        (("{}", "--box", "9000,9000,20,20"), "box 9000,9000,20,20"),
        (("{}", "--box", "9000,9000,20,20"), "in the frame of 320x240; a box is x, y, w, h"),
        (("{}", "--box", "280,200,310,230"), "as corners x1, y1, x2, y2: then w is x2 - x1"),
        (("{}", "--box", "0.4,0.33,0.2,0.32"), "less than a pixel; a box is x, y, w, h in pixels and not shares"),
        (("{}",), "--box --boxes --keyframes --select"),
        (("{}", "--box", "1,2,3,4", "--select"), "not allowed with"),
        (("{}", "--box", "1,2,3,4", "--format", "xml"), "xml"),
        (("{}", "--box", "1,2,3,4", "--video", "x.gif"), "no codec for x.gif"),
        (("{}", "--box", "1,2,3,4", "--output", "nosuch/x.csv"), "no folder for"),
        (("{}", "--box", "1,2,3,4", "--config", "nosuch.json"), "nosuch.json: "),
        (("{}/img/1.png", "--box", "1,2,3,4"), "is one image"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_2(folder, args, says, tmp_path):
    done = track(*(a.format(folder) for a in args), cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert says in done.stderr
    assert done.stderr.startswith("mfcmt track: ")
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words", [["{} {} {} {}"], ["{}", "{}", "{}", "{}"], ["{},", "{},", "{},", "{}"], ["{},{}", "{},{}"]]
)
def test_a_box_may_be_written_with_spaces(folder, box, words):
    numbers = iter(box.split(","))
    spaced = [word.format(*(next(numbers) for _ in range(word.count("{}")))) for word in words]
    done = track("--box", *spaced, folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == track(folder, "--box", box).stdout


def test_a_box_may_lie_partly_outside(folder):
    """Its first number may be negative and is no option."""
    for box in (["-5,80,64,78"], ["-5", "80", "64", "78"], ["5,-8,64,78"]):
        done = track(folder, "--box", *box)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.splitlines()[1].startswith(f"0,,target,{','.join(box)},tracking")


def test_failures_while_tracking_are_one_line_and_exit_1(folder, box, tmp_path):
    (tmp_path / "empty").mkdir()
    assert track(tmp_path / "empty", "--box", box).returncode == 2
    broken = tmp_path / "broken"
    broken.mkdir()
    for i in (1, 2, 3):
        (broken / f"{i}.png").write_bytes((folder / "img" / f"{i}.png").read_bytes())
    (broken / "3.png").write_bytes(b"not an image")
    out = tmp_path / "boxes.csv"
    done = track(broken, "--box", box, "--output", out)
    assert done.returncode == 1
    assert done.stderr == f"mfcmt track: cannot read {broken / '3.png'}: not a JPEG, PNG or WebP image\n"
    assert len(out.read_text().splitlines()) == 3  # what was tracked until then is kept
    (broken / "3.png").unlink()
    (broken / "3.png").symlink_to("nowhere")
    done = track(broken, "--box", box)
    assert (done.returncode, done.stderr) == (
        1,
        f"mfcmt track: cannot read {broken / '3.png'}: No such file or directory\n",
    )
    (tmp_path / "text.mp4").write_text("not a video")
    done = track(tmp_path / "text.mp4", "--box", box)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)


def test_a_refused_box_leaves_an_old_file_alone(folder, tmp_path):
    old = tmp_path / "old.csv"
    old.write_text("old")
    assert track(folder, "--box", "9000,9000,20,20", "--output", old).returncode == 2
    assert old.read_text() == "old"


def test_a_reader_that_leaves_is_no_error(folder, box):
    command = f"{SCRIPT} track {folder} --box {box} | head -n 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("frame,")


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_progress_on_a_terminal_only(folder, box):
    import pty

    reader, terminal = pty.openpty()
    done = subprocess.run(
        [SCRIPT, "track", folder, "--box", box],
        stdout=subprocess.PIPE,
        stderr=terminal,
        timeout=300,
        check=False,
    )
    os.close(terminal)
    said = os.read(reader, 65536).decode()
    os.close(reader)
    assert done.returncode == 0
    assert f"{LENGTH}/{LENGTH} frames" in said
    assert "\x1b" not in done.stdout.decode()


@pytest.mark.parametrize(("live", "code"), [(True, 0), (False, 130)])
def test_interrupt_ends_a_camera_well_and_keeps_what_was_tracked(clip, box, tmp_path, monkeypatch, live, code):
    def frames():
        yield from (Frame(i, i / 30, image) for i, image in enumerate(clip.frames[:5]))
        raise KeyboardInterrupt

    monkeypatch.setattr("mfcmt_core.cli.follow.open_source", lambda *_: Source(frames(), None, 30.0, live))
    out, video = tmp_path / "boxes.csv", tmp_path / "seen.avi"
    assert main(["track", "0", "--box", box, "--output", str(out), "--video", str(video)]) == code
    assert len(out.read_text().splitlines()) == 6
    assert cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_FRAME_COUNT) == 5
