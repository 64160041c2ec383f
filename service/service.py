"""The parts of one running service, as the calls see them."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from .auth import Gate
from .lanes.interface import Lanes
from .observability.exposition import Exposition
from .observability.metrics import Metrics
from .problems import ProblemError
from .sessions.book import SessionBook
from .sessions.bucket import Bucket
from .sessions.session import Session
from .settings import Settings


@dataclass(slots=True)
class Service:
    """Built by ``create_app``; one for each application."""

    settings: Settings
    lanes: Lanes
    book: SessionBook
    gate: Gate
    metrics: Metrics
    exposition: Exposition
    buckets: dict[str, Bucket] = field(default_factory=dict)

    def spend(self, owner: str) -> None:
        """Count a call or handshake of this key. Raises rate-limited."""
        now = time.monotonic()
        bucket = self.buckets.setdefault(owner, Bucket(self.settings.max_requests_per_s, now))
        if wait_s := bucket.take(now):
            raise ProblemError("rate-limited", "too many calls", retry_after_s=round(wait_s, 3))

    def describe(self, session: Session, base_url: str) -> dict[str, Any]:
        """The Session of the protocol; ``base_url`` is how the caller reaches the service."""
        scheme, _, rest = (self.settings.public_url or base_url.rstrip("/")).partition("://")
        secure = "wss" if scheme in ("https", "wss") else "ws"
        return {
            "id": session.id,
            "created_at": instant(session.created_at),
            "expires_at": instant(self.book.expires_at(session)),
            "label": session.options.label,
            "preset": session.options.preset,
            "size": session.size,
            "seq": session.seq,
            "region": session.region,
            "targets": session.told_targets(),
            "stream": {
                "url": f"{secure}://{rest}/v1/sessions/{session.id}/stream",
                "attached": session.attachment is not None,
            },
        }


def instant(moment: Any) -> str:
    told: str = moment.isoformat(timespec="milliseconds")
    return told.replace("+00:00", "Z")
