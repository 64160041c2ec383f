"""Who is asking: API keys, one-use tickets, browser origins."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from .problems import ProblemError
from .sessions.memory import Memory
from .settings import Settings

ANYONE = "anyone"
TICKET_PROTOCOL = "mfcmt.ticket."


@dataclass(frozen=True, slots=True)
class Ticket:
    """What a ticket opens."""

    owner: str
    session: str


class Gate:
    """Keys are kept and compared as digests, in constant time."""

    def __init__(self, settings: Settings, clock: Callable[[], float]) -> None:
        self._keys = [_digest(key.get_secret_value()) for key in settings.api_keys]
        self._admin = _digest(settings.admin_key.get_secret_value()) if settings.admin_key else None
        self._origins = frozenset(settings.allowed_origins)
        self._tickets: Memory[Ticket] = Memory(settings.max_tickets, settings.ticket_s, clock)

    def owner(self, headers: Mapping[str, str]) -> str:
        """Who shows this key: an opaque name. Raises unauthenticated."""
        if not self._keys:
            return ANYONE
        shown = _shown(headers)
        if shown is None:
            raise _unauthenticated("no key was shown")
        digest = _digest(shown)
        # Every key is compared, so that time tells nothing about which is near.
        matches = [hmac.compare_digest(digest, key) for key in self._keys]
        if not any(matches):
            raise _unauthenticated("the key is not valid")
        return self._keys[matches.index(True)].hex()[:32]

    def check_admin(self, headers: Mapping[str, str]) -> None:
        """Raises unauthenticated where an admin key is set and not shown."""
        if self._admin is None:
            return
        shown = _shown(headers)
        if shown is None or not hmac.compare_digest(_digest(shown), self._admin):
            raise _unauthenticated("the admin key is needed")

    def check_origin(self, headers: Mapping[str, str]) -> None:
        """Raises origin-refused for a browser's page that is neither the service's own nor on the list."""
        origin = headers.get("origin")
        if origin is not None and not self.allows(origin.lower(), headers.get("host", "").lower()):
            raise ProblemError("origin-refused", "the origin is not on the list")

    def allows(self, origin: str, host: str) -> bool:
        """Whether a page of ``origin`` may call the service at ``host``; both in lower case."""
        return origin in self._origins or (bool(host) and origin in (f"http://{host}", f"https://{host}"))

    def issue(self, owner: str, session: str, seconds: float) -> str:
        """A ticket for one handshake."""
        ticket = secrets.token_urlsafe(32)
        self._tickets.put(_digest(ticket).hex(), Ticket(owner, session), seconds)
        return ticket

    def redeem(self, protocols: Sequence[str], session: str) -> str | None:
        """The owner by the ticket among the offered subprotocols, spent by this; None without one.

        Raises unauthenticated.
        """
        shown = [p.removeprefix(TICKET_PROTOCOL) for p in protocols if p.startswith(TICKET_PROTOCOL)]
        if not shown:
            return None
        found = [self._tickets.pop(_digest(ticket).hex()) for ticket in shown]
        if found[0] is None or found[0].session != session:
            raise _unauthenticated("the ticket is not valid")
        return found[0].owner


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode()).digest()


def _shown(headers: Mapping[str, str]) -> str | None:
    scheme, _, key = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and key.strip():
        return key.strip()
    return headers.get("x-api-key")


def _unauthenticated(detail: str) -> ProblemError:
    problem = ProblemError("unauthenticated", detail)
    problem.headers["WWW-Authenticate"] = "Bearer"
    return problem
