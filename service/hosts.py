"""The host names that a service without keys answers to."""

from __future__ import annotations

import re
from functools import lru_cache
from ipaddress import ip_address

LOCAL = "localhost"
AUTHORITY = re.compile(r"(?:\[([0-9a-f:.]+)\]|([^\[\]:@/]+))(?::\d*)?")


class Hosts:
    """The names that nobody else can point at this machine: IP addresses, localhost, those that the operator set."""

    def __init__(self, *own: str) -> None:
        self._names = frozenset(filter(None, map(_name, own)))

    def know(self, host: str) -> bool:
        """Return whether a ``Host`` header, in lower case, has one of the names; or is absent, as in no browser."""
        name = _name(host)
        return not host or name == LOCAL or name.endswith(f".{LOCAL}") or name in self._names or _is_address(name)


def is_local_page(origin: str) -> bool:
    """Return whether an origin, in lower case, is of a page that the browser's own machine serves over http(s)."""
    name = _name(origin)
    local = name == LOCAL or name.endswith(f".{LOCAL}") or (_is_address(name) and ip_address(name).is_loopback)
    return local and origin.startswith(("http://", "https://"))


@lru_cache(256)
def _name(text: str) -> str:
    """Return the host name in a URL or in ``host:port``; "" if there is none."""
    _, url, rest = text.lower().partition("://")
    authority = rest.partition("/")[0] if url else text.lower()
    if _is_address(authority):
        return authority  # an IPv6 address without brackets, as in MFCMT_HOST
    found = AUTHORITY.fullmatch(authority)
    return (found[1] or found[2]).rstrip(".") if found else ""


@lru_cache(256)
def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
