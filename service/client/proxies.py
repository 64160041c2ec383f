"""Finds the proxy that leads to a service."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.util import find_spec
from ipaddress import ip_address, ip_network
from urllib.parse import SplitResult, urlsplit
from urllib.request import getproxies, proxy_bypass

from .errors import ConnectionLost

# What HTTP calls and what WebSockets need to speak SOCKS.
SOCKS_PACKAGES = {"socksio": "socksio", "python_socks": "python-socks"}
SCHEMES = ("http", "https", "socks5", "socks5h")


@dataclass(frozen=True, slots=True)
class Proxy:
    """A proxy and where it is set; as text it shows no password."""

    url: str
    variable: str

    def __str__(self) -> str:
        parts = urlsplit(self.url)
        return f"the proxy {parts.scheme}://{parts.netloc.rpartition('@')[2]} ({self.variable})"


def proxy_of(url: SplitResult) -> Proxy | None:
    """Return the proxy that the environment sets for a service, for its HTTP calls and its WebSockets alike.

    None for this machine itself, and for what NO_PROXY names. Raises :class:`ConnectionLost` for a proxy that
    cannot be used.
    """
    host = url.hostname or ""
    set_for = getproxies()
    found = next((name for name in (url.scheme, "all") if set_for.get(name)), None)
    if found is None or _is_this_machine(host) or _is_named(host, url.port, set_for.get("no", "")):
        return None
    given = set_for[found]
    proxy = Proxy(given if "://" in given else f"http://{given}", _variable(found))
    _check(proxy)
    return proxy


def _is_this_machine(host: str) -> bool:
    try:
        address = ip_address(host)
        return address.is_loopback or address.is_unspecified
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")


def _is_named(host: str, port: int | None, no_proxy: str) -> bool:
    """Whether NO_PROXY names the host: by name or a part of it, by address or network."""
    if proxy_bypass(host if port is None else f"{host}:{port}"):
        return True
    try:
        address = ip_address(host)
    except ValueError:
        return False
    for entry in no_proxy.split(","):
        try:
            if address in ip_network(entry.strip().strip("[]"), strict=False):
                return True
        except ValueError:
            continue
    return False


def _variable(name: str) -> str:
    wanted = f"{name}_proxy"
    # getproxies prefers the lower-case name
    return next((v for v in (wanted, wanted.upper()) if os.environ.get(v)), "the system's settings")


def _check(proxy: Proxy) -> None:
    scheme = urlsplit(proxy.url).scheme
    if scheme not in SCHEMES:
        raise ConnectionLost(f"{proxy} cannot be used: {' and '.join(SCHEMES)} can")
    if scheme.startswith("socks"):
        missing = [package for module, package in SOCKS_PACKAGES.items() if find_spec(module) is None]
        if missing:
            hint = f"pip install {' '.join(missing)}, or name the service's host in NO_PROXY"
            raise ConnectionLost(f"{proxy} speaks SOCKS, for which a package is missing: {hint}")
