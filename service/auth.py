"""Who is asking: API keys, one-use tickets, browser origins."""

from __future__ import annotations

import hmac
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import structlog

from .keys import Identity, by_digest, digest, read_keys
from .problems import ProblemError
from .sessions.memory import Memory
from .settings import Settings

ANYONE = "anyone"
TICKET_PROTOCOL = "mfcmt.ticket."

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
        self._file_is: tuple[int, ...] = ()
        self._keys = self._fixed
        self._admin = digest(settings.admin_key.get_secret_value()) if settings.admin_key else None
        self._origins = frozenset(settings.allowed_origins)
        self._tickets: Memory[Ticket] = Memory(settings.max_tickets, settings.ticket_s, clock)

        self.refresh()

    def refresh(self) -> bool:
        """Read the file of keys again if it is another one: whether the keys have changed.

        A file that cannot be read changes nothing.
        """
        if self._file is None:
            return False
        try:
            told = os.stat(self._file)
            file_is: tuple[int, ...] = (told.st_ino, told.st_mtime_ns, told.st_size)
        except OSError:
            file_is = ()
        if file_is == self._file_is:
            return False
        self._file_is = file_is
        try:
            keys = self._fixed | read_keys(self._file)
        except ValueError as unreadable:
            log.error("the keys stay as they were", reason=str(unreadable))
            return False
        changed, self._keys = keys != self._keys, keys
        if changed:
            log.info("keys read", keys=len(keys))
        return changed

    def owners(self) -> int:
        """How many owners the keys stand for; one where everyone is let in."""
        return len(set(self._keys.values())) or 1

    def knows(self, identity: Identity) -> bool:
        """Whether the key that the identity was shown with is good still."""
        return not self._keys or self._keys.get(identity.key) == identity.owner

    def identify(self, headers: Mapping[str, str]) -> Identity:
        """Who shows this key. Raises unauthenticated."""
        if not self._keys:
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

    def check_origin(self, headers: Mapping[str, str]) -> None:
        """Raises origin-refused for a browser's page that is neither the service's own nor on the list."""
        origin = headers.get("origin")
        if origin is not None and not self.allows(origin.lower(), headers.get("host", "").lower()):
            raise ProblemError("origin-refused", "the origin is not on the list")

    def allows(self, origin: str, host: str) -> bool:
        """Whether a page of ``origin`` may call the service at ``host``; both in lower case."""
        return origin in self._origins or (bool(host) and origin in (f"http://{host}", f"https://{host}"))

    def issue(self, identity: Identity, session: str, seconds: float) -> str:
        """A ticket for one handshake."""
        ticket = secrets.token_urlsafe(32)
        self._tickets.put(digest(ticket).hex(), Ticket(identity, session), seconds)
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
