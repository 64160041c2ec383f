"""The service that ``--url`` and ``--key`` name."""

from __future__ import annotations

from urllib.parse import urlsplit

from mfcmt_core.cli import UsageError

from ..client import AsyncClient, ConnectionLost


def host_of(url: str, key: str | None) -> str:
    """Return the host of a service's URL. Raises UsageError if the client would refuse the URL, the key or a proxy."""
    try:
        return urlsplit(AsyncClient(url, key=key).address.url).hostname or ""
    except (ValueError, ConnectionLost) as wrong:
        raise UsageError(f"--url and --key: {wrong}") from wrong
