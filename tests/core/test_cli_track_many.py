"""``mfcmt track`` with a file of boxes: several targets, and many videos in one go."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mfcmt_core import MFCMT
from mfcmt_core.cli import UsageError
from mfcmt_core.cli.box_files import read_boxes
from mfcmt_core.video.write import VideoWriter
from tests.commands import run_command

SCRIPT = Path(sys.executable).with_name("mfcmt")
LENGTH = 10


@pytest.fixture(scope="module")
def film(clip, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("film") / "clip.mp4"
    writer = VideoWriter(path, 25)
    for at, frame in enumerate(clip.frames[:LENGTH]):
        writer.write(frame, at / 25)
    writer.close()
    return path


@pytest.fixture
def folder(film, tmp_path) -> Path:
    """Return a folder of three videos, one of which is cut off, and one that is no video."""
    place = tmp_path / "videos"
    place.mkdir()
    for name in ("a,1.mp4", "b.mp4"):
        shutil.copy(film, place / name)
    (place / "cut.mp4").write_bytes(film.read_bytes()[:500])
    (place / "spare.mp4").write_bytes(b"")
    return place


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.open()))


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_several_targets_are_followed_as_each_alone(clip, film, tmp_path):
    x, y, w, h = clip.boxes[0]
    boxes = write(
        tmp_path / "b.csv", f"name,class,frame,x,y,w,h\nplate,thing,0,{x},{y},{w},{h}\nlate,,4,200,60,50,40\n"
    )
    out = tmp_path / "o.csv"
    done = run_command("track", film, "--boxes", boxes, "--output", out)
    assert (done.returncode, done.stderr) == (0, "")
    found = rows(out)
    plate = [r for r in found if r["target"] == "plate"]
    late = [r for r in found if r["target"] == "late"]
    assert [int(r["frame"]) for r in plate] == list(range(LENGTH))
    assert [int(r["frame"]) for r in late] == list(range(4, LENGTH))
    alone = run_command("track", film, "--box", f"{x},{y},{w},{h}", "--name", "plate").stdout.splitlines()[1:]
    assert [",".join(r.values()) for r in plate] == alone
    done = run_command("track", film, "--boxes", boxes, "--format", "otb")
    assert (done.returncode, "has one target" in done.stderr) == (2, True)


def test_a_target_that_begins_after_the_end_or_has_no_place_is_told(film, tmp_path):
    boxes = write(tmp_path / "b.csv", "name,frame,x,y,w,h\na,0,100,80,50,40\nb,99,1,2,30,40\nc,3,9000,2,30,40\n")
    done = run_command("track", film, "--boxes", boxes)
    assert done.returncode == 1
    assert "c, frame 3: " in done.stderr
    assert "b begins at frame 99, after the last" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert len(done.stdout.splitlines()) == 1 + LENGTH


def test_many_videos_are_tracked_and_go_on_where_they_stopped(clip, folder, tmp_path):
    box = ",".join(map(str, clip.boxes[0]))
    boxes = write(tmp_path / "b.csv", f'file,x,y,w,h\n"a,1.mp4",{box}\nb,{box}\ncut.mp4,{box}\nabsent.mp4,{box}\n')
    out = tmp_path / "out"
    words = ("track", folder, "--boxes", boxes, "--output", out, "--jobs", "2", "--video", tmp_path / "seen")
    done = run_command(*words)
    assert done.returncode == 1
    for name in ("a,1.mp4", "b.mp4"):
        assert f"{name}: {LENGTH} tracking" in done.stderr
        assert len(rows(out / f"{name}.csv")) == LENGTH
    assert "mfcmt track: absent.mp4: not in " in done.stderr
    assert "mfcmt track: cut.mp4: not a video: " in done.stderr
    assert f"mfcmt track: spare.mp4: {boxes} has no box for it" in done.stderr
    assert done.stderr.endswith("3 failed; the same command tries them again\n")
    assert sorted(p.name for p in (tmp_path / "seen").iterdir()) == ["a,1.mp4", "b.mp4"]
    library = list(MFCMT().track(clip.frames[:LENGTH], clip.boxes[0]))
    assert float(rows(out / "b.mp4.csv")[-1]["x"]) == pytest.approx(library[-1].box[0], abs=2)

    before = (out / "b.mp4.csv").stat().st_mtime_ns
    shutil.copy(folder / "b.mp4", folder / "cut.mp4")
    again = run_command(*words)
    assert "2 of 3 are finished already" in again.stderr
    assert (out / "b.mp4.csv").stat().st_mtime_ns == before
    assert len(rows(out / "cut.mp4.csv")) == LENGTH
    refused = run_command(*words[:-1], folder)
    assert (refused.returncode, "would be overwritten" in refused.stderr) == (2, True)
    other = run_command(*words, "--preset", "paper")  # made with another configuration: all anew
    assert "finished already" not in other.stderr


def test_a_signal_ends_all_and_the_next_run_takes_up_the_rest(clip, folder, film, tmp_path):
    import av

    long = folder / "long.mp4"
    with av.open(str(film)) as old, av.open(str(long), "w") as new:
        stream = new.add_stream_from_template(old.streams.video[0])
        packets = [p for p in old.demux(video=0) if p.size]
        span = packets[-1].pts + packets[-1].duration
        for turn in range(1500):
            for packet in packets:
                copy = av.Packet(bytes(packet))
                copy.pts, copy.dts = packet.pts + turn * span, packet.dts + turn * span
                copy.time_base, copy.is_keyframe, copy.stream = packet.time_base, packet.is_keyframe, stream
                new.mux(copy)
    box = list(map(float, clip.boxes[0]))
    boxes = write(tmp_path / "b.json", json.dumps({"b.mp4": box, "long.mp4": {"one": box, "two": box}}))
    out = tmp_path / "out"
    words = [SCRIPT, "track", folder, "--boxes", boxes, "--output", out, "--jobs", "1"]
    with subprocess.Popen(list(map(str, words)), stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        path = out / "long.mp4.csv"
        while not (path.exists() and path.stat().st_size > 2000) and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=120)
    assert process.returncode == 128 + signal.SIGTERM
    assert "Traceback" not in said
    kept = rows(path)
    assert {r["target"] for r in kept} == {"one", "two"}
    assert kept[-1]["confidence"]
    assert list(json.loads((out / "finished.json").read_text())) == ["b.mp4"]


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("b.csv", "", "has no boxes"),
        ("b.csv", "1,2,3\n", "needs a first line with names of columns"),
        ("b.csv", "x,y,w,h,color\n1,2,3,4,red\n", "unknown column color"),
        ("b.csv", "x,y,w,h\n1,2,3\n", "line 2 has 3 values for 4 columns"),
        ("b.csv", "x,y,w,h\n1,2,3,four\n", "line 2: could not convert"),
        ("b.csv", "x,y,w,h\n1,2,0,4\n", "line 2: the box has no area"),
        ("b.csv", "name,y,w,h,x,frame\na,2,3,4,1,-1\n", "frames count from 0"),
        ("b.json", "{", "Expecting property name"),
        ("b.json", "3", "neither a list nor an object"),
        ("b.json", '{"a.mp4": {"box": [1, 2, 3]}}', "entry 1|a.mp4: not enough values"),
        ("b.json", '{"a.mp4": [{"x": 1, "y": 2, "w": 3}]}', "'h' is missing"),
        ("none.csv", None, "No such file"),
    ],
)
def test_a_wrong_file_of_boxes_is_named_with_the_place(name, text, says, tmp_path):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(UsageError, match=says):
        read_boxes(tmp_path / name, "target", "object")


def test_files_of_boxes_may_be_written_in_several_ways(tmp_path):
    texts = {
        "header.csv": "\ufefffile,name,x,y,w,h\r\na.mp4,one,1,2,3,4\r\na.mp4,two,5,6,7,8\r\n",
        "plain.csv": "a.mp4,one,1,2,3,4\na.mp4,two,5,6,7,8\n",
        "names.json": '{"a.mp4": {"one": [1, 2, 3, 4], "two": [5, 6, 7, 8]}}',
        "list.json": '{"a.mp4": [{"name": "one", "box": [1, 2, 3, 4]},'
        '{"name": "two", "x": 5, "y": 6, "w": 7, "h": 8}]}',
        "flat.json": '[{"file": "a.mp4", "name": "one", "box": [1, 2, 3, 4]},'
        '{"file": "a.mp4", "name": "two", "box": [5, 6, 7, 8]}]',
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        found = read_boxes(tmp_path / name, "target", "object")["a.mp4"]
        assert [(s.target.id, s.target.name, s.box) for s in found] == [
            (1, "one", (1, 2, 3, 4)),
            (2, "two", (5, 6, 7, 8)),
        ], name
    (tmp_path / "bare.csv").write_text("1,2,3,4\n5,6,7,8\n")
    assert [s.target.name for s in read_boxes(tmp_path / "bare.csv", "ball", "object")[""]] == ["ball", "ball-2"]
