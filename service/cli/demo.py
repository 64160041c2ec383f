"""``mfcmt demo``: a service of its own and its page in the browser, with the sample clip already running."""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import threading
import webbrowser
from contextlib import ExitStack
from ipaddress import ip_address
from pathlib import Path
from types import FrameType
from typing import Any

from mfcmt_core.cli import UsageError, has_screen

from ..certificate import CertificateError, self_signed
from ..load.own import LOOPBACK, OwnServer, ServerFailed
from . import phone, terminal
from .address import check_free, chosen_port

FRAGMENT = "#demo"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--no-browser", action="store_true", help="only print the page's address")
    add("--port", metavar="N", help="port of the page; default: MFCMT_PORT, else a free one")
    add("--https", action="store_true", help="for a phone in the same network: its camera needs https; shows a QR code")
    add(
        "--host",
        metavar="ADDRESS",
        help="with --https: the address to listen on; default: this machine's in its network",
    )
    add("--terminal", action="store_true", help="no page: stream a clip and print what comes back")
    terminal.configure(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until a signal; the exit code."""
    if args.terminal:
        return terminal.run(args)
    if args.source or args.box or args.url or args.key:
        raise UsageError("a source, --box, --url and --key go with --terminal; on the page a video is chosen there")
    if args.host and not args.https:
        raise UsageError("--host goes with --https; without it the page is for this machine alone")
    host = _address(args.host) if args.https else LOOPBACK
    port = chosen_port(args.port, 0)
    check_free(host, port)
    stopped = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stopped.set()

    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, stop)
    try:
        with ExitStack() as stack:
            server = stack.enter_context(_server(host, port, stack, https=args.https))
            if args.https:
                print(_for_a_phone(server.url), flush=True)
            else:
                address = f"{server.url}/{FRAGMENT}"
                print(f"the page is at {address} (Ctrl-C ends it)", flush=True)
                if not args.no_browser and has_screen():
                    webbrowser.open(address)
            while not stopped.wait(0.5):
                if server.exit_code is not None:
                    raise ServerFailed(f"the server ended with {server.exit_code}")
    except (ServerFailed, CertificateError) as failed:
        print(f"mfcmt demo: {failed}", file=sys.stderr)
        return 1
    return 0


def _address(given: str | None) -> str:
    """Return the IPv4 address to listen on for a phone. Raises UsageError."""
    if given is None:
        return phone.network_address()
    try:
        address = ip_address(given)
    except ValueError:
        raise UsageError(f"--host is an IP address, as 192.168.1.7, not {given!r}") from None
    if address.version != 4 or address.is_unspecified:
        raise UsageError("--host is the IPv4 address that the phone shall open, as 192.168.1.7")
    return given


def _server(host: str, port: int, stack: ExitStack, *, https: bool) -> OwnServer:
    """Return a server that is not started yet; its certificate goes with ``stack``."""
    common: dict[str, Any] = {"log_format": "console", "drain_grace_s": 0, "host": host, "port": port}
    if not https:
        return OwnServer(**common)
    certificate, key = self_signed(Path(stack.enter_context(tempfile.TemporaryDirectory())), host)
    return OwnServer(**common, tls_certificate=certificate, tls_key=key, allow_unauthenticated=True)


def _for_a_phone(url: str) -> str:
    return (
        f"{phone.qr_code(url)}\n"
        f"the page is at {url} (Ctrl-C ends it)\n"
        "The certificate was made for this run, so the phone warns of it once: let it go on. Until then everybody in\n"
        "this network can open the page."
    )
