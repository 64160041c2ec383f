"""Clients that others generate from ``/openapi.json``: they type-check, and the Python one does a whole session."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path

import pytest

from service.load.clips import Clip
from service.load.own import OwnServer
from tests.service.jsclient.conftest import node_with
from tests.service.live.conftest import Serve

HERE = Path(__file__).parent
KEY = "a-key-for-generated-clients"
# What the generator cannot read; every call can be made without.
NOT_READ = {"application/msgpack", "application/vnd.mfcmt.snapshot", "image/jpeg", "image/png", "image/webp"}
# The base class is the generator's own, and the same for every document.
MYPY = "[mypy]\nstrict = true\n[mypy-mfcmt_api.client]\nignore_errors = true\n"


def done(*call: str, cwd: Path) -> str:
    run = subprocess.run(call, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout + run.stderr


@pytest.fixture
def server(own_server: Serve) -> OwnServer:
    return own_server(api_keys=KEY)


@pytest.fixture
def document(server: OwnServer, tmp_path: Path) -> Path:
    """The OpenAPI document as a running service tells it."""
    connection = HTTPConnection("127.0.0.1", server.port, timeout=30)
    connection.request("GET", "/openapi.json")
    path = tmp_path / "openapi.json"
    path.write_bytes(connection.getresponse().read())
    connection.close()
    return path


def test_a_generated_python_client_does_a_whole_session(
    server: OwnServer, document: Path, clip: Clip, tmp_path: Path
) -> None:
    generate = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"]
    said = done(*generate, "--path", str(document), "--output-path", "mfcmt_api", cwd=tmp_path)
    unread = {line.split()[-1] for line in said.splitlines() if line.startswith("Unsupported content type")}
    assert unread == NOT_READ
    assert "Cannot parse" not in said
    assert "ERROR" not in said
    shutil.copy(HERE / "session.py", tmp_path)
    (tmp_path / "mypy.ini").write_text(MYPY)
    done(sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "session.py", "mfcmt_api", cwd=tmp_path)
    frames = [tmp_path / f"{index}.jpg" for index in range(4)]
    for path, frame in zip(frames, clip.frames, strict=False):
        path.write_bytes(frame)
    box = ",".join(map(str, clip.box))
    printed = json.loads(done(sys.executable, "session.py", server.url, KEY, box, *map(str, frames), cwd=tmp_path))
    assert printed == {
        "label": "generated",
        "several": 2,
        "seqs": [[1, "raw"], [2, 2.5], [3, None]],
        "corrected": list(clip.box),
        "removed": 204,
        "restored": 3,
        "past": [0, 1, 2, 3],
        "ticket": True,
        "listed": 4,
        "now": [3, 1],
        "protocol": 1,
        "health": ["ok", "ok"],
        "metrics": True,
        "ended": [204] * 4,
        "gone": ["session-gone", 410],
    }


def test_generated_typescript_types_fit_a_session(document: Path, tmp_path: Path) -> None:
    node = node_with(HERE)
    shutil.copy(HERE / "session.ts", tmp_path)
    shutil.copy(HERE / "tsconfig.json", tmp_path)
    (tmp_path / "node_modules").symlink_to(HERE / "node_modules")
    done(node, "node_modules/openapi-typescript/bin/cli.js", str(document), "-o", "api.d.ts", cwd=tmp_path)
    assert done(node, "node_modules/typescript/bin/tsc", "-p", ".", cwd=tmp_path) == ""
