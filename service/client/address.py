"""Where a service is, and how a client identifies itself there."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self
from urllib.parse import SplitResult, urlencode, urlsplit

from .proxies import Proxy, proxy_of

HEADER_VALUE = re.compile(r"[\x21-\x7e]+")


@dataclass(frozen=True, slots=True)
class Address:
    """The base URL of a service, the headers of every request to it, and the proxy on the way."""

    url: str
    headers: Mapping[str, str]
    proxy: Proxy | None
    ping_interval_s: float
    timeout_s: float

    @classmethod
    def of(cls, url: str, key: str | None, ping_interval_s: float, timeout_s: float) -> Self:
        """Return the address that a user gave. Raises ValueError; ConnectionLost for a proxy that cannot be used."""
        parts = _checked(url)
        if key and not HEADER_VALUE.fullmatch(key):
            raise ValueError("key must not contain spaces, line ends or characters beyond ASCII")
        headers = {} if not key else {"Authorization": f"Bearer {key}"}
        return cls(parts.geturl(), headers, proxy_of(parts), ping_interval_s, timeout_s)

    def stream(self, session_id: str, query: Mapping[str, str]) -> str:
        """Return the URL of a session's stream."""
        base = "ws" + self.url.removeprefix("http")
        return f"{base}/v1/sessions/{session_id}/stream?{urlencode(query)}"

    def failed(self, failure: BaseException) -> str:
        """Return what went wrong on the way, with the proxy where there is one."""
        return f"{self.url}{self.way}: {failure or type(failure).__name__}"

    @property
    def proxy_url(self) -> str | None:
        """The proxy's URL, with its password."""
        return None if self.proxy is None else self.proxy.url

    @property
    def way(self) -> str:
        """The proxy in words, or nothing."""
        return "" if self.proxy is None else f" through {self.proxy}"


def _checked(url: str) -> SplitResult:
    """Return the parts of a base URL, without a slash at the end. Raises ValueError."""
    if "@" in str(url):
        raise ValueError("url must not contain a user and password; give an API key as key")
    try:
        parts = urlsplit(url.strip())
        whole = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except (AttributeError, ValueError):  # not a text, or with a bad port
        whole = False
    if not whole:
        raise ValueError(f"url must be http:// or https:// with a host, such as http://127.0.0.1:8000, not {url!r}")
    if parts.query or parts.fragment:
        raise ValueError(f"url must be the service's base, without a query or fragment, not {url!r}")
    return parts._replace(path=parts.path.rstrip("/"))
