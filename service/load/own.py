"""A server in a child process for measurements, the demo and tests, on a free loopback port unless it is told another.

It ends with the process that started it, even if that one is killed.
"""

from __future__ import annotations

import http.client
import os
import secrets
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Self

START_S = 180.0
STOP_S = 20.0
POLL_S = 0.05
LOOPBACK = "127.0.0.1"
# The server ends when its standard input does, which the kernel closes with the parent process. (The signal at a
# parent's death would follow the thread that started the server, which may end long before.)
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
    """The server ended or did not get ready; the message ends with its last log lines."""


class OwnServer:
    """``mfcmt serve`` with ``settings`` (fields of :class:`service.settings.Settings`), ready when entered.

    ``port`` 0 takes a free one. Variables ``MFCMT_*`` of the caller's environment do not reach the server;
    ``environment`` is added to its environment. ``prelude`` is Python that the server runs before it starts.
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
        self._host = str(settings.get("host", LOOPBACK))
        self.port = port

    @property
    def url(self) -> str:
        scheme = "https" if "tls_certificate" in self._settings else "http"
        return f"{scheme}://{self._host}:{self.port}"

    @property
    def pid(self) -> int:
        """The process id of the front."""
        assert self._process is not None
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """The exit code; None while the server runs."""
        assert self._process is not None
        return self._process.poll()

    @property
    def log(self) -> str:
        """The whole log, in JSON lines unless ``log_format`` is another."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._log.unlink(missing_ok=True)

    def start(self) -> None:
        """Start the server and wait until it is ready; after a :meth:`stop` or a crash it takes the same port again."""
        self.port = self.port or free_port()
        settings = {"log_format": "json", "host": self._host} | self._settings | {"port": self.port}
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
        """Stop the server by SIGTERM, or by SIGKILL if it does not end in time."""
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
            connection = self._connection()
            try:
                connection.request("GET", "/readyz")
                if connection.getresponse().status == 200:
                    return
            except OSError:
                pass
            finally:
                connection.close()
            time.sleep(POLL_S)
        raise ServerFailed(f"the server is not ready after {self._start_s:g} s\n{self._last_words()}")

    def _connection(self) -> http.client.HTTPConnection:
        if self.url.startswith("https"):
            # the server is this process' own, whatever its certificate says
            unverified = ssl._create_unverified_context()  # noqa: S323
            return http.client.HTTPSConnection(self._host, self.port, timeout=2, context=unverified)
        return http.client.HTTPConnection(self._host, self.port, timeout=2)

    def _last_words(self) -> str:
        return "\n".join(self.log.splitlines()[-20:])


def free_port() -> int:
    """Return a loopback port on which nothing listens now.

    It is none of those that systems give to outgoing connections and to whoever asks for any port, so nobody gets it by
    chance before it is used, or while a server that had it is started again.
    """
    while True:
        port = 20_000 + secrets.randbelow(12_000)
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
