"""The parts of one running service, as the calls see them."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping
from dataclasses import dataclass
from typing import Any

import structlog

from .auth import Gate
from .keys import Identity
from .lanes.interface import Lanes
from .observability.exposition import Exposition
from .observability.metrics import Metrics
from .sessions.byte_budget import ANONYMOUS, ByteBudget
from .sessions.concurrency import ConcurrencyLimit
from .sessions.rate_limiter import RateLimiter
from .sessions.registry import SessionRegistry
from .sessions.session import Attachment, Session
from .settings import Settings
from .snapshot_signer import SnapshotSigner

KEYS_EVERY_S = 1.0
PROBES = frozenset({"/livez", "/readyz", "/metrics"})

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.service")


@dataclass(slots=True)
class Service:
    """Built by ``create_app``; one for each application."""

    settings: Settings
    lanes: Lanes
    registry: SessionRegistry
    gate: Gate
    metrics: Metrics
    exposition: Exposition
    rate_limiter: RateLimiter
    byte_budget: ByteBudget
    signer: SnapshotSigner
    snapshot_slots: ConcurrencyLimit
    trajectory_slots: ConcurrencyLimit

    async def late(self, scope: MutableMapping[str, Any]) -> None:
        """Count the refusal of a call or handshake, and wait if its caller has too many. Probes never wait."""
        if scope["path"] not in PROBES:
            identity: Identity | None = scope["state"].get("identity")
            await asyncio.sleep(self.rate_limiter.refusal_delay_s(identity.owner if identity else ANONYMOUS))

    async def follow_keys(self) -> None:
        """Cut the streams of keys that are revoked and forget old tickets, for as long as the service runs."""
        while True:
            await asyncio.sleep(KEYS_EVERY_S)
            self.gate.sweep()
            if self.gate.refresh():
                cut = self.registry.end_streams(4401, "the key was revoked", self._revoked)
                log.info("streams of revoked keys cut", streams=cut)

    def _revoked(self, stream: Attachment) -> bool:
        return not self.gate.knows(stream.identity)

    def describe(self, session: Session, base_url: str) -> dict[str, Any]:
        """The Session of the protocol; ``base_url`` is how the caller reaches the service."""
        scheme, _, rest = (self.settings.public_url or base_url.rstrip("/")).partition("://")
        secure = "wss" if scheme in ("https", "wss") else "ws"
        return {
            "id": session.id,
            "created_at": instant(session.created_at),
            "expires_at": instant(self.registry.expires_at(session)),
            "label": session.options.label,
            "preset": session.options.preset,
            "size": session.size,
            "seq": session.seq,
            "region": session.region,
            "targets": session.target_maps(),
            "stream": {
                "url": f"{secure}://{rest}/v1/sessions/{session.id}/stream",
                "attached": session.attachment is not None,
            },
        }


def instant(moment: Any) -> str:
    told: str = moment.isoformat(timespec="milliseconds")
    return told.replace("+00:00", "Z")
