"""Installs what lock files name into the environment whose Python runs this, then the project itself, editable.

usage: .venv/bin/python .ci/install.py requirements.lock

uv does it where it is installed, with its own progress; else pip, of whose many lines a count is shown.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

PROJECT = ["--no-deps", "--no-build-isolation", "-e", "."]
# A package is counted when pip turns to it.
TURN = re.compile(r"(?:Collecting|Requirement already satisfied:) ([^\s(;]+)")
SIZE = re.compile(r"  Downloading \S+ \((.+)\)")


def main(lock: str) -> int:
    """The exit code of what did the work."""
    count = len(re.findall(r"^[A-Za-z0-9]", Path(lock).read_text(encoding="utf-8"), re.M))
    print(f"installing the {count} packages of {lock} into {Path(sys.prefix).name}", flush=True)
    if uv := shutil.which("uv"):
        command = [uv, "pip", "install", "--python", sys.executable]
        if run([*command, "--require-hashes", "-r", lock]) == 0 and run([*command, "--quiet", *PROJECT]) == 0:
            return 0
        print("uv could not; now with pip", file=sys.stderr, flush=True)
    command = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--no-compile"]
    code = with_count([*command, "--progress-bar=off", "--no-deps", "--require-hashes", "-r", lock], count)
    return code or run([*command, "--quiet", "--root-user-action=ignore", *PROJECT])


def run(command: list[str]) -> int:
    return subprocess.run(command, check=False).returncode


def with_count(command: list[str], count: int) -> int:
    """Run pip and show how many of ``count`` packages it has come to; all that it said if it fails."""
    said: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as pip:
        assert pip.stdout is not None
        with Status() as status:
            done, name = 0, ""
            for line in pip.stdout:
                said.append(line)
                if found := TURN.match(line):
                    done, name = done + 1, found[1]
                    status.show(f"{done} of {count}: {name}", lasting=done % 10 == 0)
                elif found := SIZE.match(line):
                    status.show(f"{done} of {count}: {name} ({found[1]})")
                elif line.startswith("Installing"):
                    status.show("unpacking what was fetched", lasting=True)
    if pip.returncode:
        sys.stderr.write("".join(said))
    return pip.returncode


class Status:
    """On a terminal one line that is written over, with the seconds so far; elsewhere the lasting lines."""

    def __init__(self) -> None:
        self._start, self._text = time.monotonic(), "asking the package index"
        self._ended = threading.Event()
        self._clock = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> Status:
        if sys.stdout.isatty():
            self._clock.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if sys.stdout.isatty():
            self._clock.join()
            print("\r\033[K", end="", flush=True)

    def show(self, text: str, *, lasting: bool = False) -> None:
        self._text = text
        if lasting and not sys.stdout.isatty():
            print(f"  {text}", flush=True)

    def _tick(self) -> None:
        while not self._ended.wait(0.2):
            seconds = time.monotonic() - self._start
            print(f"\r\033[K  {self._text}, {seconds:.0f} s"[:118], end="", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
