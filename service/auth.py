"""Who is asking: API keys, one-use tickets, browser origins."""

from __future__ import annotations

import hmac
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import structlog

from .hosts import Hosts
from .keys import Identity, by_digest, digest, read_keys
from .problems import ProblemError
from .sessions.ttl_cache import TTLCache
from .settings import Settings

ANYONE = "anyone"
TICKET_PROTOCOL = "mfcmt.ticket."
UNKNOWN_HOST = "without keys only addresses, localhost and the hosts of MFCMT_HOST and MFCMT_PUBLIC_URL are answered to"

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.auth")


@dataclass(frozen=True, slots=True)
class Ticket:
    """What a ticket opens, and for whom."""

    identity: Identity
    session: str


class Gate:
    """Keys are kept and compared as digests, in constant time."""

    def __init__(self, settings: Settings, clock: Callable[[], float]) -> None:
        self._fixed = by_digest(key.get_secret_value() for key in settings.api_keys)
        self._file = settings.api_keys_file
        self._file_is = self._file_was = self._look()
        self._open = not settings.authenticated
        self._keys = self._read() or self._fixed
        self._admin = digest(settings.admin_key.get_secret_value()) if settings.admin_key else None
        self._origins = frozenset(settings.allowed_origins)
        self._hosts = Hosts(settings.host, settings.public_url) if self._open else None
        self._tickets: TTLCache[Ticket] = TTLCache(settings.max_tickets, settings.ticket_s, clock)

    def refresh(self) -> bool:
        """Read the file of keys again if it has changed and is at rest: whether the keys have changed.

        It is at rest when two calls in a row find it the same: one that is being written would revoke those keys that
        it does not hold yet. A file that cannot be read changes nothing.
        """
        found = self._look()
        rests, self._file_was = found == self._file_was, found
        if not rests or found == self._file_is:
            return False
        keys = self._read()
        if keys is not None and self._look() != found:
            return False  # it was written meanwhile
        self._file_is = found
        if keys is None or keys == self._keys:
            return False
        self._keys = keys
        log.info("keys read", keys=len(keys))
        return True

    def sweep(self) -> None:
        """Forget tickets that are too old."""
        self._tickets.sweep()

    def _look(self) -> tuple[int, ...]:
        """What changes with the file of keys; nothing where it is not to be had."""
        if self._file is None:
            return ()
        try:
            told = os.stat(self._file)
        except OSError:
            return ()
        return told.st_ino, told.st_mtime_ns, told.st_size

    def _read(self) -> dict[bytes, str] | None:
        """All keys, those of the file among them; None if it cannot be read."""
        if self._file is None:
            return self._fixed
        try:
            return self._fixed | read_keys(self._file)
        except ValueError as unreadable:
            log.error("the keys stay as they were", reason=str(unreadable))
            return None

    def owners(self) -> int:
        """How many owners the keys stand for; one where everyone is let in."""
        return len(set(self._keys.values())) or 1

    def knows(self, identity: Identity) -> bool:
        """Whether the key that the identity was shown with is good still."""
        return self._open or self._keys.get(identity.key) == identity.owner

    def identify(self, headers: Mapping[str, str]) -> Identity:
        """Who shows this key. Raises unauthenticated."""
        if self._open:
            return Identity(ANYONE, b"")
        shown = _shown(headers)
        if shown is None:
            raise _unauthenticated("no key was shown")
        told = digest(shown)
        # Every key is compared, so that time tells nothing about which is near.
        matches = [key for key in self._keys if hmac.compare_digest(told, key)]
        if not matches:
            raise _unauthenticated("the key is not valid")
        return Identity(self._keys[matches[0]], matches[0])

    def check_admin(self, headers: Mapping[str, str]) -> None:
        """Raises unauthenticated where an admin key is set and not shown."""
        if self._admin is None:
            return
        shown = _shown(headers)
        if shown is None or not hmac.compare_digest(digest(shown), self._admin):
            raise _unauthenticated("the admin key is needed")

    def check_browser(self, headers: Mapping[str, str]) -> None:
        """Raises host-refused, origin-refused for a browser's page that may not call the service.

        A page has to be the service's own or on the list. Whoever owns a name can point it at this service, and a
        browser then takes his page for the service's own. A key would protect it; where there are none, the service
        answers to names alone that are its own.
        """
        host = headers.get("host", "").lower()
        if not self._answers_to(host):
            raise ProblemError("host-refused", UNKNOWN_HOST)
        origin = headers.get("origin")
        if origin is not None and not self.allows(origin.lower(), host):
            raise ProblemError("origin-refused", "the origin is not on the list")

    def allows(self, origin: str, host: str) -> bool:
        """Whether a page of ``origin`` may call the service at ``host``; both in lower case."""
        if origin in self._origins:
            return True
        return bool(host) and origin in (f"http://{host}", f"https://{host}") and self._answers_to(host)

    def _answers_to(self, host: str) -> bool:
        return self._hosts is None or self._hosts.know(host)

    def issue(self, identity: Identity, session: str, seconds: float) -> str:
        """A ticket for one handshake."""
        ticket = secrets.token_urlsafe(32)
        self._tickets.put(identity.owner, digest(ticket).hex(), Ticket(identity, session), seconds)
        return ticket

    def redeem(self, protocols: Sequence[str], session: str) -> Identity | None:
        """Who the ticket is of, among the offered subprotocols; spent by this. None without one.

        Raises unauthenticated.
        """
        shown = [p.removeprefix(TICKET_PROTOCOL) for p in protocols if p.startswith(TICKET_PROTOCOL)]
        if not shown:
            return None
        found = [self._tickets.pop(digest(ticket).hex()) for ticket in shown]
        if found[0] is None or found[0].session != session or not self.knows(found[0].identity):
            raise _unauthenticated("the ticket is not valid")
        return found[0].identity


def _shown(headers: Mapping[str, str]) -> str | None:
    scheme, _, key = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and key.strip():
        return key.strip()
    return headers.get("x-api-key")


def _unauthenticated(detail: str) -> ProblemError:
    problem = ProblemError("unauthenticated", detail)
    problem.headers["WWW-Authenticate"] = "Bearer"
    return problem
