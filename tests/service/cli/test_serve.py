"""What `mfcmt serve` says when it is ready."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable

import pytest

from service.load.own import OwnServer
from tests.conftest import require

KEY = "a-key-for-the-first-session-0123"


def said(server: OwnServer) -> str:
    """The log, once it tells that the service is ready."""
    for _ in range(600):
        if "/v1/sessions\n" in (log := server.log):
            return log
        time.sleep(0.05)
    pytest.fail(f"no first session in {server.log}")


@pytest.mark.parametrize("settings", [{}, {"api_keys": KEY}], ids=["open", "with keys"])
def test_the_command_that_it_prints_makes_a_session(
    own_server: Callable[..., OwnServer], settings: dict[str, str]
) -> None:
    require(shutil.which("curl"), "no curl")
    server = own_server(log_format="console", **settings)
    log = said(server)
    assert f"ready: the page is at {server.url}" in log
    (command,) = (line for line in log.splitlines() if line.startswith("  curl "))
    done = subprocess.run(["sh", "-c", command], env=os.environ | {"KEY": KEY}, capture_output=True, check=True)
    assert json.loads(done.stdout)["targets"][0]["status"] == "tracking"


def test_a_log_for_machines_stays_one(own_server: Callable[..., OwnServer]) -> None:
    server = own_server(log_format="json")
    while '"ready"' not in server.log:
        time.sleep(0.05)
    lines = [json.loads(line) for line in server.log.splitlines()]
    assert [line["url"] for line in lines if line["event"] == "ready"] == [server.url]
