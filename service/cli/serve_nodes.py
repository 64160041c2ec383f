"""``mfcmt serve --nodes N``: several nodes on this machine, each a process of its own, which share the store."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from types import FrameType
from urllib.parse import urlsplit

import structlog

from mfcmt_core.cli import UsageError

from ..lanes.confine import die_with_parent
from ..settings import Settings

SERVE = "import sys; from mfcmt_core.cli import main; sys.exit(main(['serve']))"
# A node that ended by itself is started again after this time.
AGAIN_S = 1.0
MOST_NODES = 64

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.serve")


def environments(count: int, settings: Settings) -> list[dict[str, str]]:
    """Return what the environment of each node has beside that of this process. Raises UsageError.

    Node ``i`` listens on the port after that of node ``i - 1``, and the lanes are shared out evenly.
    """
    if not 1 <= count <= MOST_NODES:
        raise UsageError(f"--nodes is a number from 1 to {MOST_NODES}")
    if not os.environ.get("MFCMT_STORE"):
        raise UsageError("--nodes needs MFCMT_STORE, a Redis or Valkey, as redis://127.0.0.1:6379/0")
    if settings.port == 0 or settings.port + count - 1 > 65535:
        raise UsageError("--nodes needs a port with as many free ports behind it: set MFCMT_PORT")
    url = urlsplit(os.environ.get("MFCMT_NODE_URL") or _own_url(settings))
    host = f"[{url.hostname}]" if ":" in (url.hostname or "") else url.hostname
    name = os.environ.get("MFCMT_NODE") or _machine()
    return [
        {
            "MFCMT_NODE": f"{name}-{index}",
            "MFCMT_PORT": str(settings.port + index),
            "MFCMT_NODE_URL": f"{url.scheme}://{host}:{settings.port + index}",
            "MFCMT_HOST": settings.host,
            "MFCMT_LANES": str(max(1, settings.lanes // count)),
            "MFCMT_LOG_FORMAT": settings.log_format,
            "MFCMT_LOG_LEVEL": settings.log_level,
        }
        for index in range(count)
    ]


def run(count: int, settings: Settings) -> int:
    """Run the nodes until a signal, which each of them gets; return the greatest of their exit codes."""
    added = environments(count, settings)
    nodes = [_start(one) for one in added]
    stopping = False

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        nonlocal stopping
        stopping = True
        for node in nodes:
            if node.poll() is None:
                node.send_signal(signal.SIGTERM)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    while any(node.poll() is None for node in nodes) or not stopping:
        time.sleep(AGAIN_S / 4 if stopping else AGAIN_S)
        for index, node in enumerate(nodes):
            code = node.poll()
            if code is not None and not stopping:
                if code == 1:  # it could not start, and has said why
                    stop(signal.SIGTERM, None)
                    break
                log.error("a node ended and is started again", node=added[index]["MFCMT_NODE"], exit_code=code)
                nodes[index] = _start(added[index])
    return max(int(abs(node.returncode)) for node in nodes)


def _start(added: dict[str, str]) -> subprocess.Popen[bytes]:
    # In a session of its own, so that the terminal's Ctrl-C reaches a node once: through this process.
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", SERVE], env=os.environ | added, start_new_session=True, preexec_fn=die_with_parent
    )


def _own_url(settings: Settings) -> str:
    if settings.host in ("0.0.0.0", "::"):  # noqa: S104
        raise UsageError("--nodes needs MFCMT_NODE_URL, this machine's URL for clients, as http://tracker.lan:8000")
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    return f"http://{host}:{settings.port}"


def _machine() -> str:
    """Return this machine's name as the beginning of a node's."""
    return re.sub(r"[^a-z0-9]+", "-", socket.gethostname().partition(".")[0].lower()).strip("-")[:50] or "node"
