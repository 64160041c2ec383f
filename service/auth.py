"""Authentication: API keys, one-use tickets, browser origins."""

from __future__ import annotations

import base64
import contextlib
import hmac
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import structlog

from .hosts import LOCAL, Hosts, is_local_page
from .keys import Identity, by_digest, digest, read_keys
from .protocol.enums import ProblemCode
from .protocol.problems import ProblemError
from .sessions.ttl_cache import TTLCache
from .settings import Settings

ANYONE = "anyone"
TICKET_PROTOCOL = "mfcmt.ticket."
UNKNOWN_HOST = (
    "a service without keys answers to IP addresses, localhost and the hosts of MFCMT_HOST and MFCMT_PUBLIC_URL alone"
)

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.auth")


@dataclass(frozen=True, slots=True)
class IssuedTicket:
    """The session that a ticket opens, and the identity of its owner."""

    identity: Identity
    session: str


class Authenticator:
    """Tells callers by their keys and tickets. Keys are kept as digests and compared in constant time."""

    def __init__(self, settings: Settings, clock: Callable[[], float]) -> None:
        self._fixed = by_digest(key.get_secret_value() for key in settings.api_keys)
        self._file = settings.api_keys_file
        self._read_version = self._seen_version = self._file_version()
        self._open = not settings.authenticated
        self._keys = self._read() or self._fixed
        self._admin = digest(settings.admin_key.get_secret_value()) if settings.admin_key else None
        self._origins = frozenset(settings.allowed_origins)
        self._hosts = Hosts(settings.host, settings.public_url) if self._open else None
        self._tickets: TTLCache[IssuedTicket] = TTLCache(settings.max_tickets, settings.ticket_s, clock)

    def refresh(self) -> bool:
        """Read the key file again if it has changed and is at rest. Return whether the keys have changed.

        The file is at rest when two calls in a row find it unchanged. A file that is still being written would revoke
        the keys that it does not hold yet. A file that cannot be read changes nothing.
        """
        found = self._file_version()
        at_rest, self._seen_version = found == self._seen_version, found
        if not at_rest or found == self._read_version:
            return False
        keys = self._read()
        if keys is not None and self._file_version() != found:
            return False  # it was written meanwhile
        self._read_version = found
        if keys is None or keys == self._keys:
            return False
        self._keys = keys
        log.info("keys read", keys=len(keys))
        return True

    def sweep(self) -> None:
        """Drop tickets that have expired."""
        self._tickets.sweep()

    def _file_version(self) -> tuple[int, ...]:
        """Return numbers that change with the key file; none if it cannot be read."""
        if self._file is None:
            return ()
        try:
            found = os.stat(self._file)
        except OSError:
            return ()
        return found.st_ino, found.st_mtime_ns, found.st_size

    def _read(self) -> dict[bytes, str] | None:
        """Return all keys, those of the file included; None if the file cannot be read."""
        if self._file is None:
            return self._fixed
        try:
            return self._fixed | read_keys(self._file)
        except ValueError as unreadable:
            log.error("key file not read: the keys stay as they were", reason=str(unreadable))
            return None

    def owners(self) -> int:
        """Return how many owners the keys belong to: one if there are no keys."""
        return len(set(self._keys.values())) or 1

    def knows(self, identity: Identity) -> bool:
        """Return whether the identity's key is still valid."""
        return self._open or self._keys.get(identity.key) == identity.owner

    def identify(self, headers: Mapping[str, str]) -> Identity:
        """Return the identity of the key in ``headers``. Raises unauthenticated."""
        if self._open:
            return Identity(ANYONE, b"")
        shown = _shown(headers)
        if shown is None:
            raise _unauthenticated("no key was shown")
        wanted = digest(shown)
        # Every key is compared, so that the time says nothing about the keys.
        matches = [key for key in self._keys if hmac.compare_digest(wanted, key)]
        if not matches:
            raise _unauthenticated("the key is not valid")
        return Identity(self._keys[matches[0]], matches[0])

    def check_admin(self, headers: Mapping[str, str]) -> None:
        """Raise unauthenticated if an admin key is set and ``headers`` do not have it."""
        if self._admin is None:
            return
        shown = _shown(headers)
        if shown is None or not hmac.compare_digest(digest(shown), self._admin):
            raise _unauthenticated("the admin key is needed")

    def check_browser(self, headers: Mapping[str, str]) -> None:
        """Raise host-refused or origin-refused if a browser's page may not call the service.

        A page must be the service's own or come from an allowed origin. The owner of any domain can point it at this
        service, and a browser then takes the owner's page for the service's own. A key protects against that. Without
        keys, the service answers to its own names alone.
        """
        host = headers.get("host", "").lower()
        if not self._answers_to(host):
            raise ProblemError(ProblemCode.HOST_REFUSED, UNKNOWN_HOST)
        origin = headers.get("origin")
        if origin is not None and not self.allows(origin.lower(), host):
            detail = f"pages of {origin[:100]} may not call this service: add the origin to MFCMT_ALLOWED_ORIGINS"
            raise ProblemError(ProblemCode.ORIGIN_REFUSED, detail)

    def allows(self, origin: str, host: str) -> bool:
        """Return whether a page of ``origin`` may call the service at ``host``; both in lower case."""
        if origin in self._origins or (LOCAL in self._origins and is_local_page(origin)):
            return True
        return bool(host) and origin in (f"http://{host}", f"https://{host}") and self._answers_to(host)

    def _answers_to(self, host: str) -> bool:
        return self._hosts is None or self._hosts.know(host)

    def issue(self, identity: Identity, session: str, seconds: float) -> str:
        """Return a new ticket for one handshake, valid for ``seconds``."""
        ticket = secrets.token_urlsafe(32)
        self._tickets.put(identity.owner, ticket_name(ticket), IssuedTicket(identity, session), seconds)
        return ticket

    def peek(self, ticket: str) -> IssuedTicket | None:
        """Return what a ticket opens, by its digest, without spending it; None if this node does not know it."""
        return self._tickets.get(ticket)

    def learn(self, ticket: str, issued: IssuedTicket, seconds: float) -> None:
        """Count a ticket of another node, by its digest, as one of ours."""
        self._tickets.put(issued.identity.owner, ticket, issued, seconds)

    def void(self, ticket: str) -> None:
        """Forget a ticket, by its digest: it was spent at another node."""
        self._tickets.pop(ticket)

    def redeem(self, protocols: Sequence[str], session: str) -> Identity | None:
        """Spend the ticket among the offered subprotocols and return its owner's identity; None without a ticket.

        Raises unauthenticated if the ticket is unknown, spent, expired, or of another session.
        """
        shown = shown_tickets(protocols)
        if not shown:
            return None
        found = [self._tickets.pop(ticket) for ticket in shown]
        if found[0] is None or found[0].session != session or not self.knows(found[0].identity):
            raise _unauthenticated("the ticket is not valid")
        return found[0].identity


def shown_tickets(protocols: Sequence[str]) -> list[str]:
    """Return the digests of the tickets among the offered subprotocols."""
    shown = (p.removeprefix(TICKET_PROTOCOL) for p in protocols if p.startswith(TICKET_PROTOCOL))
    return [ticket_name(ticket) for ticket in shown]


def ticket_name(ticket: str) -> str:
    """Return the digest of a ticket, under which it is kept."""
    return digest(ticket).hex()


def _shown(headers: Mapping[str, str]) -> str | None:
    """Return the key in ``headers``: a bearer's, the password of any user, or that of ``X-API-Key``."""
    scheme, _, rest = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and rest.strip():
        return rest.strip()
    if scheme.lower() == "basic":
        with contextlib.suppress(ValueError):
            return base64.b64decode(rest.strip(), validate=True).decode().partition(":")[2]
    return headers.get("x-api-key")


def _unauthenticated(detail: str) -> ProblemError:
    problem = ProblemError(ProblemCode.UNAUTHENTICATED, detail)
    problem.headers["WWW-Authenticate"] = "Bearer"
    return problem
