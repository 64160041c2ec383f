"""A server of one's own: a child process on a free loopback port, for measurements, the demo and tests.

It ends with the process that started it, killed or not.
"""

from __future__ import annotations

import http.client
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Self

START_S = 180.0
STOP_S = 20.0
POLL_S = 0.05
# Its standard input ends with the process that started it, however that one ends. (What the kernel can signal at a
# parent's death follows the thread that started it, which may end long before.)
SERVE = """
import os, signal, sys, threading
def follow():
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
threading.Thread(target=follow, daemon=True).start()
{prelude}
from mfcmt_core.cli import main
sys.exit(main(['serve']))
"""


class ServerFailed(Exception):
    """The server ended or did not get ready; the message ends with what it last logged."""


class OwnServer:
    """``mfcmt serve`` with ``settings`` (fields of :class:`service.settings.Settings`), ready when entered.

    ``port`` 0 takes a free one. What the caller's environment sets as ``MFCMT_*`` does not reach it;
    ``environment`` is added to it. ``prelude`` is Python that the server runs before it starts.
    """

    def __init__(
        self,
        *,
        start_s: float = START_S,
        port: int = 0,
        environment: Mapping[str, str] | None = None,
        prelude: str = "",
        **settings: object,
    ) -> None:
        self._start_s = start_s
        self._environment = environment or {}
        self._program = SERVE.format(prelude=prelude)
        self._settings = settings
        self._process: subprocess.Popen[bytes] | None = None
        self._log = Path(tempfile.mkstemp(prefix="mfcmt-serve-", suffix=".log")[1])
        self.port = port

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        """The front's process id."""
        assert self._process is not None
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        assert self._process is not None
        return self._process.poll()

    @property
    def log(self) -> str:
        """All that it has logged: JSON lines, unless ``log_format`` says otherwise."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._log.unlink(missing_ok=True)

    def start(self) -> None:
        """Start and wait until it is ready; on the same port again after a :meth:`stop` or a crash."""
        self.port = self.port or free_port()
        settings = {"log_format": "json", "host": "127.0.0.1"} | self._settings | {"port": self.port}
        environment = {name: value for name, value in os.environ.items() if not name.startswith("MFCMT_")}
        environment |= self._environment
        environment |= {f"MFCMT_{name.upper()}": str(value) for name, value in settings.items()}
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(  # noqa: S603
                [sys.executable, "-c", self._program],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
            )
        try:
            self._wait_until_ready()
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """SIGTERM, and SIGKILL where that is not enough."""
        if self._process is None:
            return
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()

    def _wait_until_ready(self) -> None:
        give_up = time.monotonic() + self._start_s
        while time.monotonic() < give_up:
            if self.exit_code is not None:
                raise ServerFailed(f"the server ended with {self.exit_code}\n{self._last_words()}")
            try:
                connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=2)
                connection.request("GET", "/readyz")
                if connection.getresponse().status == 200:
                    return
            except OSError:
                pass
            finally:
                connection.close()
            time.sleep(POLL_S)
        raise ServerFailed(f"the server is not ready after {self._start_s:g} s\n{self._last_words()}")

    def _last_words(self) -> str:
        return "\n".join(self.log.splitlines()[-20:])


def free_port() -> int:
    """A loopback port that nothing listens on just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
