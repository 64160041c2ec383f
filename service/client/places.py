"""Where the sessions of a service are that has several nodes."""

from __future__ import annotations

import re
from dataclasses import replace

from .address import Address

OF_SESSION = re.compile(r"(?:http|ws)(s?)(://.+)/v1/sessions/([^/?]+)(?:[/?].*)?")


class Places:
    """The nodes that have sessions, as the service has said; any other session is found by the service's own URL."""

    def __init__(self, address: Address) -> None:
        self._address = address
        self._urls: dict[str, str] = {}

    def address(self, session_id: str) -> Address:
        """Return where a session is, as far as it is known."""
        url = self._urls.get(session_id)
        return self._address if url is None else replace(self._address, url=url)

    def url(self, path: str) -> str:
        """Return the URL of a call."""
        found = OF_SESSION.fullmatch(self._address.url + path)
        return (self._urls.get(found[3], self._address.url) if found else self._address.url) + path

    def learn(self, url: str) -> None:
        """Remember the node in the URL of a session, of one of its calls or of its stream."""
        found = OF_SESSION.fullmatch(url)
        if found is not None and (found[1] or not self._address.url.startswith("https")):
            self._urls[found[3]] = f"http{found[1]}{found[2]}"

    def forget(self, session_id: str) -> bool:
        """Ask the service's own URL again, because the node does not answer; return whether a node was known."""
        return self._urls.pop(session_id, None) is not None

    def forget_url(self, url: str) -> bool:
        """Do as :meth:`forget` for the session in the URL of a call."""
        found = OF_SESSION.fullmatch(url)
        return found is not None and self.forget(found[3])
