"""``mfcmt health``: for a container's health check; needs nothing but the standard library."""

from __future__ import annotations

import argparse
import contextlib
import http.client
import os
import ssl
import sys

from .address import chosen_port

TIMEOUT_S = 2.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--port", help="of the service on this machine; default: MFCMT_PORT, else 8000")
    parser.add_argument("--ready", action="store_true", help="ask whether new sessions are welcome, not only for life")


def run(args: argparse.Namespace) -> int:
    """0 if the service answers that it is well, else 1 and why on standard error."""
    port = chosen_port(args.port, 8000)
    path = "/readyz" if args.ready else "/livez"
    host = os.environ.get("MFCMT_HOST", "127.0.0.1")
    here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104
    if os.environ.get("MFCMT_TLS_CERTIFICATE"):
        # this machine asks itself: the certificate is of the name that others use
        unverified = ssl._create_unverified_context()  # noqa: S323
        connection: http.client.HTTPConnection = http.client.HTTPSConnection(
            here, port, timeout=TIMEOUT_S, context=unverified
        )
    else:
        connection = http.client.HTTPConnection(here, port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        body = answer.read(1000).decode(errors="replace")
    except (OSError, http.client.HTTPException) as failed:
        print(f"no answer from port {port}: {failed}", file=sys.stderr)
        with contextlib.suppress(ImportError):  # only now: settings take longer to load than the question
            from ..settings import unread_settings

            for line in unread_settings():
                print(line, file=sys.stderr)
        return 1
    finally:
        connection.close()
    if answer.status != 200:
        print(body, file=sys.stderr)
        return 1
    return 0
