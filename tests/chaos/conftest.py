"""Clips and servers, as for the tests of the service; and servers whose lanes can be made to misbehave."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from service.load.own import OwnServer
from tests.service.conftest import clip, own_server

__all__ = ["clip", "misbehaving", "own_server"]

POISON = b"(poison)"
SLEEP = b"(sleep)"
FAULT = b"(fault)"
GROW = b"(grow)"

# Runs in each Python process of a server; only in its fork server, and so in its lanes, it does something.
SITE = f"""
import sys
if any("forkserver" in argument for argument in sys.orig_argv):
    from service.lanes import operations, preload
    from mfcmt_core import MFCMT
    import mmap, os, signal, time
    grown = mmap.mmap(-1, 1)  # shared by all lanes
    handle, update = operations.LaneOperations.handle, MFCMT.update

    def misbehave(self, op, key, args, data):
        if op in ("create", "track") and data.endswith({POISON!r}):
            os.kill(os.getpid(), signal.SIGKILL)
        if op == "track" and data.endswith({SLEEP!r}):
            time.sleep(60)
        if op == "track" and data.endswith({GROW!r}):
            if not grown[0]:
                grown[0] = 1
                operations.held = b"grow" * (120 << 20)
        reply = handle(self, op, key, args, data)
        if op == "track" and data.endswith({FAULT!r}):
            raise RuntimeError("a fault, when the work was done")
        return reply

    operations.LaneOperations.handle = misbehave
"""


@pytest.fixture
def misbehaving(own_server: Callable[..., OwnServer], tmp_path: Path) -> Callable[..., OwnServer]:
    """Servers whose lanes die of frames that end with ``POISON``, hang at ``SLEEP``, break at ``FAULT``, grow at
    the first ``GROW``."""
    (tmp_path / "sitecustomize.py").write_text(SITE)

    def start(**settings: object) -> OwnServer:
        return own_server(environment={"PYTHONPATH": str(tmp_path)}, **settings)

    return start
