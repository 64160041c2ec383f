"""``mfcmt demo``: a service of its own and its page in the browser, with the sample clip already running."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import webbrowser
from types import FrameType

from mfcmt_core.cli import UsageError, has_screen

from ..load.own import OwnServer, ServerFailed
from . import terminal
from .address import check_free, chosen_port

FRAGMENT = "#demo"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--no-browser", action="store_true", help="only print the page's address")
    add("--port", metavar="N", help="port of the page; default: MFCMT_PORT, else a free one")
    add("--terminal", action="store_true", help="no page: stream a clip and print what comes back")
    terminal.configure(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until a signal; the exit code."""
    if args.terminal:
        return terminal.run(args)
    if args.source or args.box or args.url or args.key:
        raise UsageError("a source, --box, --url and --key go with --terminal; on the page a video is chosen there")
    port = chosen_port(args.port, 0)
    check_free("127.0.0.1", port)
    stopped = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stopped.set()

    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, stop)
    server = OwnServer(log_format="console", drain_grace_s=0, port=port)
    try:
        with server:
            address = f"{server.url}/{FRAGMENT}"
            print(f"the page is at {address} (Ctrl-C ends it)", flush=True)
            if not args.no_browser and has_screen():
                webbrowser.open(address)
            while not stopped.wait(0.5):
                if server.exit_code is not None:
                    raise ServerFailed(f"the server ended with {server.exit_code}")
    except ServerFailed as failed:
        print(f"mfcmt demo: {failed}", file=sys.stderr)
        return 1
    return 0
