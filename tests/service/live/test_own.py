"""The server that measurements and the demo start."""

from __future__ import annotations

import http.client
import subprocess
import sys
import time

import pytest

OWNER = """
import sys, time
from service.load.own import OwnServer
server = OwnServer(lanes=1)
server.start()
print(server.port, flush=True)
time.sleep(600)
"""
GONE_S = 30


def ready(port: int) -> bool:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()


def test_it_ends_with_the_process_that_started_it() -> None:
    """Killed, so that nothing in it can stop what it started."""
    with subprocess.Popen([sys.executable, "-c", OWNER], stdout=subprocess.PIPE) as owner:
        assert owner.stdout is not None
        port = int(owner.stdout.readline())
        assert ready(port)
        owner.kill()
    give_up = time.monotonic() + GONE_S
    while ready(port):
        if time.monotonic() > give_up:
            pytest.fail("the server is still there")
        time.sleep(0.1)
