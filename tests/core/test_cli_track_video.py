"""``mfcmt track`` on video files: every frame or a word, and nothing lost of what was tracked."""

from __future__ import annotations

import csv
import io
import json
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mfcmt_core.video import VideoReader
from mfcmt_core.video.write import VideoWriter
from tests.commands import run_command
from tests.core.video.films import ffmpeg

SCRIPT = Path(sys.executable).with_name("mfcmt")
LENGTH = 12


@pytest.fixture(scope="module")
def film(clip, tmp_path_factory) -> Path:
    """Write a video of variable rate with the clip's first frames."""
    path = tmp_path_factory.mktemp("film") / "clip.mp4"
    writer = VideoWriter(path, 25)
    for at, frame in enumerate(clip.frames[:LENGTH]):
        writer.write(frame, at / 25 + (at > 5) * 0.5)
    writer.close()
    return path


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_rows_have_frame_and_time_and_name(film, box, tmp_path):
    done = run_command("track", film, "--box", box, "--name", "ball, red", "--class", "ball")
    assert (done.returncode, done.stderr) == (0, "")
    found = rows(done.stdout)
    assert [int(r["frame"]) for r in found] == list(range(LENGTH))
    times = [at / 25 + (at > 5) * 0.5 for at in range(LENGTH)]
    assert [float(r["time_s"]) for r in found] == pytest.approx(times, abs=1e-3)
    assert {r["target"] for r in found} == {"ball, red"}
    lines = run_command("track", film, "--box", box, "--format", "jsonl").stdout.splitlines()
    assert [json.loads(line)["time_s"] for line in lines] == pytest.approx(times, abs=1e-3)


def test_the_annotated_video_keeps_the_times(film, box, tmp_path):
    seen = tmp_path / "seen.mp4"
    done = run_command("track", film, "--box", box, "--video", seen)
    assert (done.returncode, done.stderr) == (0, "")
    frames, source = list(VideoReader(seen)), list(VideoReader(film))
    assert [f.time_s for f in frames] == pytest.approx([f.time_s for f in source], abs=1e-4)
    assert frames[0].image.shape[1] == source[0].image.shape[1]
    x, y, w, _ = map(float, box.split(","))
    edge = frames[0].image[round(y), round(x + w / 4) : round(x + 3 * w / 4)].mean(axis=0)
    assert edge[1] > max(edge[0], edge[2])  # green


@pytest.mark.parametrize("option", ["--output", "--video"])
def test_the_source_is_no_target(option, film, box, tmp_path):
    mine = tmp_path / "mine.mp4"
    shutil.copy(film, mine)
    (tmp_path / "link.mp4").symlink_to(mine)
    for name in (mine, tmp_path / "link.mp4"):
        done = run_command("track", mine, "--box", box, option, name)
        assert done.returncode == 2
        assert "is the source, which would be overwritten" in done.stderr
    assert mine.read_bytes() == film.read_bytes()
    done = run_command("track", mine, "--box", box, "--output", tmp_path / "o.mp4", "--video", tmp_path / "o.mp4")
    assert "are the same file" in done.stderr


def test_a_file_that_is_cut_off_keeps_its_rows_and_ends_with_1(film, box, tmp_path):
    cut = tmp_path / "cut.mp4"
    ffmpeg("-i", film, "-c", "copy", "-movflags", "faststart", cut)
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size * 6 // 10])
    done = run_command("track", cut, "--box", box, "--video", tmp_path / "seen.mp4")
    count = len(rows(done.stdout))
    assert done.returncode == 1
    assert done.stderr == f"mfcmt track: {cut} ends after {count} of {LENGTH} frames, it is cut off\n"
    assert len(list(VideoReader(tmp_path / "seen.mp4"))) == count


def test_a_change_of_size_is_refused_or_rescaled(film, box, tmp_path):
    parts = []
    for number, size in enumerate(("320x240", "640x480")):
        parts.append(tmp_path / f"{number}.ts")
        ffmpeg("-i", film, "-vf", f"scale={size.replace('x', ':')}", "-c:v", "libx264", parts[-1])
    both = tmp_path / "both.ts"
    both.write_bytes(b"".join(part.read_bytes() for part in parts))
    done = run_command("track", both, "--box", box)
    assert done.returncode == 1
    assert "frame 12 is 640x480, the first one is 320x240" in done.stderr
    assert len(rows(done.stdout)) == LENGTH
    done = run_command("track", both, "--box", box, "--on-resize", "rescale", "--video", tmp_path / "seen.mp4")
    assert (done.returncode, done.stderr) == (0, "")
    found = rows(done.stdout)
    assert len(found) == 2 * LENGTH
    assert float(found[LENGTH]["w"]) == pytest.approx(2 * float(found[LENGTH - 1]["w"]))
    assert np.all(np.diff([float(r["time_s"]) for r in found]) > 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP], ids=lambda number: number.name)
def test_a_signal_keeps_rows_and_a_video_that_plays(number, film, box, tmp_path):
    long = tmp_path / "long.mp4"
    ffmpeg("-stream_loop", "400", "-i", film, "-c", "copy", long)
    out, seen = tmp_path / "o.csv", tmp_path / "seen.mp4"
    words = [SCRIPT, "track", long, "--box", box, "--output", out, "--video", seen]
    with subprocess.Popen(list(map(str, words)), stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while (not out.exists() or len(out.read_text().splitlines()) < 5) and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(number)
        _, said = process.communicate(timeout=120)
    assert (process.returncode, said) == (128 + number, "")
    count = len(rows(out.read_text()))
    assert 4 <= count < 400 * LENGTH
    assert len(list(VideoReader(seen))) == count
    assert {p.name for p in tmp_path.iterdir()} == {"long.mp4", "o.csv", "seen.mp4"}


def test_a_full_disk_is_one_line_and_what_is_done_plays(film, box, tmp_path):
    """A limit of the size of files stands for the disk."""
    long = tmp_path / "long.mp4"
    ffmpeg("-stream_loop", "20", "-i", film, "-c", "copy", long)
    (tmp_path / "out").mkdir()
    seen = tmp_path / "out" / "seen.mp4"
    done = subprocess.run(
        [str(SCRIPT), "track", str(long), "--box", box, "--video", str(seen)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000)),
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"mfcmt track: cannot write {seen}: File too large; what there is of it is in ")
    assert len(done.stderr.splitlines()) == 1
    (partial,) = (tmp_path / "out").iterdir()
    kept = ffmpeg("-i", partial, "-f", "rawvideo", "-pix_fmt", "gray", "-vf", "scale=8:8", "-")
    assert len(kept) >= 64 * 10


@pytest.mark.parametrize(("name", "reason"), [("/dev/full", "No space left"), ("{}", "Is a directory")])
def test_an_output_that_cannot_be_written_is_one_line(name, reason, film, box, tmp_path):
    path = name.format(tmp_path)
    done = run_command("track", film, "--box", box, "--output", path)
    assert done.returncode == 1
    assert done.stderr == f"mfcmt track: cannot write {path}: {reason}{' on device' * ('full' in path)}\n"
