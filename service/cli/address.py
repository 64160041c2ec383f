"""The address on which a service listens: its port, and whether it is free."""

from __future__ import annotations

import errno
import os
import socket

from mfcmt_core.cli import UsageError
from mfcmt_core.errors import MFCMTError

MAX_PORT = 65535


class CannotListen(MFCMTError):
    """The service cannot listen on the address; the message says which variable to change."""


def chosen_port(argument: str | None, default: int) -> int:
    """Return the port of ``--port``, else of MFCMT_PORT, else ``default``. Raises UsageError."""
    name, text = (
        ("MFCMT_PORT", os.environ.get("MFCMT_PORT", str(default))) if argument is None else ("--port", argument)
    )
    if not (text.isascii() and text.isdigit() and int(text[:6]) <= MAX_PORT):
        raise UsageError(f"{name} is a number from 0 to {MAX_PORT}")
    return int(text)


def check_free(host: str, port: int) -> None:
    """Raise CannotListen if a server could not listen on ``host`` and ``port``."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as failed:
        raise CannotListen(f"{host} is no address: set MFCMT_HOST (127.0.0.1 for this machine alone)") from failed
    for family, kind, protocol, _, address in found:
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            try:
                probe.bind(address)
                probe.listen(1)
            except OSError as failed:
                raise CannotListen(_why(failed, host, port)) from failed


def _why(failed: OSError, host: str, port: int) -> str:
    if failed.errno == errno.EADDRINUSE:
        return f"port {port} is in use; choose another, as with MFCMT_PORT={port + 1 if port < MAX_PORT else 0}"
    if failed.errno == errno.EACCES:
        return f"port {port} is for root; choose one above 1023, as with MFCMT_PORT=8000"
    if failed.errno == errno.EADDRNOTAVAIL:
        return f"this machine has no address {host}: set MFCMT_HOST (127.0.0.1 for this machine alone)"
    return f"cannot listen on {host}, port {port}: {failed.strerror}; see MFCMT_HOST and MFCMT_PORT"
