"""What a phone needs to open the page: an address in its network, and a QR code of it."""

from __future__ import annotations

import io
import socket
import sys

import segno

from mfcmt_core.cli import UsageError

# Nothing is sent there: the system only says from which address it would be.
ELSEWHERE = ("198.51.100.1", 9)
# Light squares on dark ones, whatever the colours of the terminal are.
COLOURS = ("\x1b[97;40m", "\x1b[0m")


def network_address() -> str:
    """Return this machine's address in its network, IPv4. Raises UsageError where it has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(ELSEWHERE)
        except OSError:
            raise UsageError(
                "this machine is in no network that a phone could reach: name its address by --host"
            ) from None
        return str(probe.getsockname()[0])


def qr_code(url: str) -> str:
    """Return lines of block characters that show ``url`` as a QR code, in the terminal's colours if it has any."""
    out = io.StringIO()
    segno.make(url, micro=False).terminal(out, compact=True)
    if not sys.stdout.isatty():
        return out.getvalue()
    before, after = COLOURS
    return "".join(f"{before}{line}{after}\n" for line in out.getvalue().splitlines())
