"""What `make serve` does before it serves: the environment, the packages, and what it says of them."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, require

INSTALL = ROOT / ".ci" / "install.py"
PIP = """
print("Collecting one==1.0")
print("  Downloading one-1.0-py3-none-any.whl (1.2 MB)")
print("Requirement already satisfied: two==2.0 in somewhere")
print("Installing collected packages: one")
"""


def program(folder: Path, name: str, text: str) -> None:
    """A script of this name in ``folder``."""
    path = folder / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


@pytest.fixture
def stranger(tmp_path: Path) -> dict[str, str]:
    """The environment of somebody who is not root and has a Python without venv; sudo and apt-get tell if they run."""
    program(tmp_path, "id", "echo 1000")
    for name in ("sudo", "apt-get"):
        program(tmp_path, name, f"echo ran {name} >&2; exit 1")
    program(tmp_path, "python3", f'case "$*" in *ensurepip*) exit 1 ;; esac; exec {sys.executable} "$@"')
    return os.environ | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}


def test_without_venv_the_message_names_the_package_to_install(stranger: dict[str, str], tmp_path: Path) -> None:
    call = ["sh", ".ci/venv", "python3", str(tmp_path / "venv")]
    done = subprocess.run(call, cwd=ROOT, env=stranger, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "apt-get install python3-venv" in done.stderr
    assert "ran " not in done.stderr
    assert not (tmp_path / "venv").exists()


def test_without_python_the_message_says_how_to_choose_one(tmp_path: Path) -> None:
    call = ["sh", ".ci/venv", "no-such-python", str(tmp_path / "venv")]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "make PYTHON=" in done.stderr


def test_pip_s_output_is_shown_only_if_it_fails(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with_count = runpy.run_path(str(INSTALL))["with_count"]
    pip = tmp_path / "pip.py"
    lines = "".join(f'print("Collecting p{n}==1.0")\n' for n in range(25))
    pip.write_text(PIP + lines)
    assert with_count([sys.executable, str(pip)], 27) == 0
    said = capfd.readouterr()
    counted = [line.split(":")[0].strip() for line in said.out.splitlines()]
    assert counted == ["unpacking what was fetched", "10 of 27", "20 of 27"]
    assert said.err == ""
    pip.write_text(PIP + "print('ERROR: no such thing'); raise SystemExit(3)")
    assert with_count([sys.executable, str(pip)], 2) == 3
    assert "no such thing" in capfd.readouterr().err


def test_scripts_pass_shellcheck() -> None:
    shellcheck = shutil.which("shellcheck")
    require(shellcheck, "no shellcheck")
    scripts = [path for path in (ROOT / ".ci").iterdir() if re.match(rb"#!.*sh\n", path.read_bytes())]
    assert len(scripts) >= 3
    done = subprocess.run([str(shellcheck), *scripts], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
