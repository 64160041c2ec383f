"""The parts of one running service, for its calls."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import structlog

from .auth import Authenticator
from .keys import Identity
from .lanes.interface import Lanes
from .observability.exporter import PrometheusExporter
from .observability.metrics import Metrics
from .protocol.answers import SessionInfo, StreamAddress, instant, message
from .protocol.enums import CloseCode
from .sessions.byte_budget import ANONYMOUS, ByteBudget
from .sessions.concurrency import ConcurrencyLimit
from .sessions.interface import AttachedStream
from .sessions.rate_limiter import RateLimiter
from .sessions.registry import SessionRegistry
from .sessions.session import Session
from .settings import Settings
from .snapshot_signer import SnapshotSigner

if TYPE_CHECKING:
    from .cluster.node import ClusterNode

KEYS_EVERY_S = 1.0
PROBES = frozenset({"/livez", "/readyz", "/metrics"})

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.service")


@dataclass(slots=True)
class Service:
    """The parts of a service; ``create_app`` makes one for each application."""

    settings: Settings
    lanes: Lanes
    registry: SessionRegistry
    authenticator: Authenticator
    metrics: Metrics
    exporter: PrometheusExporter
    rate_limiter: RateLimiter
    byte_budget: ByteBudget
    signer: SnapshotSigner
    snapshot_slots: ConcurrencyLimit
    trajectory_slots: ConcurrencyLimit
    node: ClusterNode | None = None

    async def delay_refusal(self, scope: MutableMapping[str, Any]) -> None:
        """Count the refusal of a call or handshake, and wait if its caller has had too many. Probes never wait."""
        if scope["path"] not in PROBES:
            identity: Identity | None = scope["state"].get("identity")
            await asyncio.sleep(self.rate_limiter.refusal_delay_s(identity.owner if identity else ANONYMOUS))

    async def follow_keys(self) -> None:
        """End the streams of revoked keys and drop old tickets, every second while the service runs."""
        while True:
            await asyncio.sleep(KEYS_EVERY_S)
            self.authenticator.sweep()
            if self.authenticator.refresh():
                cut = self.registry.end_streams(CloseCode.UNAUTHENTICATED, "the key was revoked", self._revoked)
                log.info("streams of revoked keys ended", streams=cut)

    def _revoked(self, stream: AttachedStream) -> bool:
        return not self.authenticator.knows(stream.identity)

    def describe(self, session: Session, base_url: str) -> dict[str, Any]:
        """Return the Session of the protocol; ``base_url`` is the URL by which the caller reaches the service."""
        base_url = self.settings.node_url or self.settings.public_url or base_url.rstrip("/")
        scheme, _, rest = base_url.partition("://")
        secure = "wss" if scheme in ("https", "wss") else "ws"
        url = f"{secure}://{rest}/v1/sessions/{session.id}/stream"
        return message(
            SessionInfo,
            id=session.id,
            created_at=instant(session.created_at),
            expires_at=instant(self.registry.expires_at(session)),
            label=session.options.label,
            preset=session.options.preset,
            size=session.size,
            seq=session.seq,
            region=session.region,
            targets=session.target_maps(),
            stream=message(StreamAddress, url=url, attached=session.attachment is not None),
        )
