"""A token bucket: so many a second, as many again at once."""

from __future__ import annotations


class Bucket:
    """``now`` of every call is of one monotonic clock."""

    def __init__(self, per_s: float, now: float) -> None:
        self._per_s = per_s
        self._tokens = max(1.0, per_s)
        self._at = now

    def take(self, now: float) -> float:
        """0 and a token is taken, or the seconds until there is one."""
        self._tokens = min(max(1.0, self._per_s), self._tokens + (now - self._at) * self._per_s)
        self._at = now
        if self._tokens < 1:
            return (1 - self._tokens) / self._per_s
        self._tokens -= 1
        return 0.0
