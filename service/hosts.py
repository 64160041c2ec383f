"""The names by which a service without keys may be called."""

from __future__ import annotations

import re
from functools import lru_cache
from ipaddress import ip_address

LOCAL = "localhost"
AUTHORITY = re.compile(r"(?:\[([0-9a-f:.]+)\]|([^\[\]:@/]+))(?::\d*)?")


class Hosts:
    """Names that nobody else can point at this machine: addresses, localhost, what the operator has named."""

    def __init__(self, *own: str) -> None:
        self._names = frozenset(filter(None, map(_name, own)))

    def know(self, host: str) -> bool:
        """Whether a ``Host`` header, in lower case, has one of the names; whoever sends none is no browser."""
        name = _name(host)
        return not host or name == LOCAL or name.endswith(f".{LOCAL}") or name in self._names or _is_address(name)


@lru_cache(256)
def _name(told: str) -> str:
    """The name of a host in a URL, or with or without its port; nothing if there is none."""
    _, url, rest = told.lower().partition("://")
    authority = rest.partition("/")[0] if url else told.lower()
    if _is_address(authority):
        return authority  # an IPv6 address without brackets, as MFCMT_HOST has it
    found = AUTHORITY.fullmatch(authority)
    return (found[1] or found[2]).rstrip(".") if found else ""


@lru_cache(256)
def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
