"""Where a service is and as whom it is called."""

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
    """The service's base URL, the headers of every request to it, and the proxy that leads there."""

    url: str
    headers: Mapping[str, str]
    proxy: Proxy | None
    ping_interval_s: float
    timeout_s: float

    @classmethod
    def of(cls, url: str, key: str | None, ping_interval_s: float, timeout_s: float) -> Self:
        """The address that a user gave. Raises ValueError, and ConnectionLost for a proxy that cannot be used."""
        parts = _checked(url)
        if key and not HEADER_VALUE.fullmatch(key):
            raise ValueError("key has a character that no key has: a space, a line's end or one beyond ASCII")
        headers = {} if not key else {"Authorization": f"Bearer {key}"}
        return cls(parts.geturl(), headers, proxy_of(parts), ping_interval_s, timeout_s)

    def stream(self, session_id: str, query: Mapping[str, str]) -> str:
        """The URL of a session's stream."""
        base = "ws" + self.url.removeprefix("http")
        return f"{base}/v1/sessions/{session_id}/stream?{urlencode(query)}"

    def failed(self, failure: BaseException) -> str:
        """What went wrong on the way, with the proxy where one is."""
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
    """The parts of a base URL, without a slash at the end. Raises ValueError."""
    if "@" in str(url):
        raise ValueError("url has no user and password in it: an API key is given as key")
    try:
        parts = urlsplit(url.strip())
        whole = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except (AttributeError, ValueError):  # no text, or a port that is none
        whole = False
    if not whole:
        raise ValueError(f"url is http:// or https:// and a host, as http://127.0.0.1:8000, not {url!r}")
    if parts.query or parts.fragment:
        raise ValueError(f"url is the service's base, without a query or fragment, not {url!r}")
    return parts._replace(path=parts.path.rstrip("/"))
