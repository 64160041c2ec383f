"""``mfcmt track`` on a stream that stalls, drops, comes back and ends."""

from __future__ import annotations

import csv
import io
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import cv2
import pytest

from mfcmt_core import MFCMT
from mfcmt_core.video import live
from tests.commands import run_command
from tests.examples import rtsp

SCRIPT = Path(sys.executable).with_name("mfcmt")
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n"

Serve = Callable[[socket.socket, int], None]


@pytest.fixture(scope="module")
def box(clip) -> str:
    for _ in MFCMT().track(clip.frames[:5], clip.boxes[0]):  # load the kernels, so that no stream waits for them
        pass
    return ",".join(map(str, clip.boxes[0]))


@pytest.fixture(scope="module")
def jpegs(clip) -> list[bytes]:
    return [cv2.imencode(".jpg", frame)[1].tobytes() for frame in clip.frames[:15]]


def part(jpeg: bytes) -> bytes:
    return b"--b\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%b\r\n" % (len(jpeg), jpeg)


@contextmanager
def camera(serve: Serve) -> Iterator[str]:
    """Serve HTTP-MJPEG: ``serve`` gets each connection, whose request was read, and its number."""
    listener = socket.create_server(("127.0.0.1", 0))

    def one(connection: socket.socket, number: int) -> None:
        with connection:
            try:
                connection.recv(4096)
                connection.sendall(HEAD)
                serve(connection, number)
            except OSError:
                pass

    def accept() -> None:
        number = 0
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=one, args=(connection, number), daemon=True).start()
            number += 1

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield f"http://user:secret@127.0.0.1:{listener.getsockname()[1]}/s.mjpg?key=secret"
    finally:
        listener.close()


def playing(jpegs: list[bytes], seconds: float) -> Serve:
    def serve(connection: socket.socket, _: int) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for jpeg in [*jpegs, *jpegs[::-1]]:
                connection.sendall(part(jpeg))
                time.sleep(0.03)

    return serve


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_stream_that_drops_is_followed_again_when_it_is_back(jpegs, box):
    def serve(connection: socket.socket, number: int) -> None:
        for jpeg in jpegs if number == 0 else jpegs * 20:
            connection.sendall(part(jpeg))
            time.sleep(0.03)
        connection.sendall(part(jpegs[0])[:2000])  # half a picture

    with camera(serve) as address:
        done = run_command("track", address, "--box", box, "--for", "4")
    assert done.returncode == 0
    said = done.stderr.splitlines()
    assert len(said) == 2
    assert said[0].startswith("mfcmt track: http://127.0.0.1:")
    assert re.search(r"is gone \((it ended|Input/output error)\), trying again in 1 s", said[0])
    assert said[1].endswith("/s.mjpg is back")
    assert "secret" not in done.stderr
    found = rows(done.stdout)
    frames, times = [int(r["frame"]) for r in found], [float(r["time_s"]) for r in found]
    assert frames[0] == times[0] == 0
    assert frames == sorted(set(frames))
    assert times[-1] == pytest.approx(4, abs=0.8)
    assert max(b - a for a, b in pairwise(times)) > 0.8  # the pause


def test_a_stream_that_stays_away_ends_with_a_word_and_1(jpegs, box, monkeypatch, tmp_path):
    """The one stalls, the other never comes back."""
    monkeypatch.setattr(live, "STALL_S", 1.0)

    def serve(connection: socket.socket, number: int) -> None:
        if number == 0:
            for jpeg in jpegs:
                connection.sendall(part(jpeg))
        time.sleep(20)

    with camera(serve) as address:
        out = tmp_path / "o.csv"
        done = run_command("track", address, "--box", box, "--retry", "3", "--output", out)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert re.search(r"/s\.mjpg is gone: no picture for 1 s", last)
    assert rows(out.read_text())


def test_ctrl_c_ends_a_stream_well(jpegs, box, tmp_path):
    out = tmp_path / "o.csv"
    with camera(playing(jpegs, 60)) as address:
        words = [SCRIPT, "track", address, "--box", box, "--output", out, "--video", tmp_path / "seen.mp4"]
        with subprocess.Popen(list(map(str, words)), stderr=subprocess.PIPE, text=True) as process:
            deadline = time.monotonic() + 60
            while (not out.exists() or len(out.read_text().splitlines()) < 8) and time.monotonic() < deadline:
                time.sleep(0.05)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=30)
    assert (process.returncode, said) == (0, "")
    assert len(rows(out.read_text())) >= 7
    assert (tmp_path / "seen.mp4").stat().st_size > 1000


@pytest.mark.parametrize(
    ("source", "code", "says"),
    [
        ("http://user:secret@127.0.0.1:9/s.mjpg", 1, "cannot open http://127.0.0.1:9/s.mjpg: Connection refused"),
        ("gopher://camera/1", 2, "gopher:// is not read; addresses of streams begin with http, https"),
        ("97", 1, "cannot open camera 97: there is no such camera"),
    ],
)
def test_a_source_that_cannot_be_opened_is_one_line(source, code, says):
    done = run_command("track", source, "--box", "1,2,30,40")
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == f"mfcmt track: {says}\n" or (code == 2 and says in done.stderr)
    assert "secret" not in done.stderr


def test_an_rtsp_camera_is_followed(clip, box):
    images = [frame for frame in clip.frames[:15] for _ in range(3)]
    with rtsp.camera(images, fps=20) as address:
        done = run_command("track", address, "--box", box, "--retry", "0")
    assert done.returncode == 1  # it ends, which no camera does
    assert "is gone: " in done.stderr
    found = rows(done.stdout)
    assert len(found) > 5
    assert {r["status"] for r in found} == {"tracking"}


def test_a_time_to_end_is_for_live_sources(tmp_path, box):
    done = run_command("track", tmp_path, "--box", box, "--for", "3")
    assert (done.returncode, "--for is for cameras and streams" in done.stderr) == (2, True)
