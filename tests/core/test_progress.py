"""Long commands tell how far they are on a terminal, and nothing in a pipe."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

SCRIPT = Path(sys.executable).with_name("mfcmt")
SHORT = [
    ["bench", "--clip", "motion", "--frames", "40", "--repeat", "1"],
    ["fuzz", "--count", "8"],
    ["soak", "--sessions", "300", "--frames", "0", "--lanes", "1"],
    ["chaos", "--faults", "1", "--restarts", "0", "--sessions", "1", "--lanes", "1"],
    ["load", "--seconds", "1"],
]
WORK = """
import sys, time
from mfcmt_core.cli.progress import Progress
with Progress(4, "things") as bar:
    for name in ("one", "two"):
        bar.begin(name, 2)
        time.sleep(0.7)
"""


def on_a_terminal(call: list[str]) -> str:
    """Return what a program writes to a terminal as its standard error."""
    pty = pytest.importorskip("pty", reason="no pseudo-terminals")
    reader, terminal = pty.openpty()
    said = bytearray()

    def read() -> None:
        try:
            while part := os.read(reader, 65536):
                said.extend(part)
        except OSError:
            pass  # the terminal is closed

    thread = threading.Thread(target=read)
    thread.start()
    done = subprocess.run(call, stdout=subprocess.PIPE, stderr=terminal, timeout=400, check=False)
    os.close(terminal)
    thread.join()
    os.close(reader)
    assert done.returncode in (0, 1)
    assert "\x1b" not in done.stdout.decode()
    return said.decode()


def test_a_terminal_shows_progress_and_the_time_left() -> None:
    said = on_a_terminal([sys.executable, "-c", WORK])
    assert re.search(r"2/4 things  \d:\d\d left  .*two", said)
    assert re.search(r"━+  4/4 things  in \d:\d\d", said)
    assert said.endswith("\n")


def test_a_narrow_terminal_shows_progress_in_one_line() -> None:
    long = WORK.replace('"two"', '"two" * 99')
    for drawn in on_a_terminal([sys.executable, "-c", long]).split("\r\x1b[2K"):
        assert len(drawn.strip()) < 80


@pytest.mark.parametrize("command", SHORT, ids=lambda command: command[0])
def test_long_commands_show_their_progress_with_the_time_left(command: list[str]) -> None:
    said = on_a_terminal([str(SCRIPT), *command])
    assert re.search(r"\d/\d+ \w+", said), said
    assert re.search(r"in \d+:\d\d", said), said


@pytest.mark.parametrize("command", [SHORT[0], SHORT[1], SHORT[4]], ids=lambda command: command[0])
def test_a_pipe_shows_no_progress(command: list[str]) -> None:
    done = subprocess.run([SCRIPT, *command], capture_output=True, text=True, timeout=400, check=False)
    assert (done.returncode, done.stderr) == (0, "")
