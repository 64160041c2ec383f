"""The environment of the real clients (`make bridges`), servers with bridges, and scripts that run in there."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.load.own import OwnServer
from tests.conftest import ROOT, require
from tests.service.conftest import clip, own_server

__all__ = ["clip", "own_server"]

BIN = ROOT / ".venv-bridges" / "bin"
KEY = "the-key-of-these-tests"
OTHER = "another-key-of-these-tests"


@pytest.fixture(scope="session")
def tools() -> Path:
    """The folder of the real clients' commands."""
    require((BIN / "python").exists(), "needs .venv-bridges (make bridges)")
    return BIN


@pytest.fixture(scope="module")
def bridged() -> Iterator[OwnServer]:
    """A service that wants keys, with all bridges that need no other setting."""
    keys = f"{KEY},{OTHER}"
    with OwnServer(lanes=2, bridges="kserve,cvat", api_keys=keys, operation_deadline_s=60, log_level="debug") as server:
        yield server


def run(command: list[str | Path], **more: Any) -> subprocess.CompletedProcess[str]:
    """Run a command of the tools' environment, without the variables of this one."""
    variables = environment(more.pop("env", {}))
    return subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False, env=variables, **more
    )


def environment(added: dict[str, str]) -> dict[str, str]:
    """The variables of a process of the tools' environment."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("MFCMT_", "PYTHON"))}
    return kept | added


def script(tools: Path, path: Path, *arguments: object) -> Any:
    """Run a script with the tools' Python, and return what it prints last as JSON."""
    done = run([tools / "python", path, *map(str, arguments)])
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])
