"""A token bucket: so many a second, as many again at once, and a debt for what is dearer than one."""

from __future__ import annotations

ROUNDING = 1e-6


class Bucket:
    """``now`` of every call is of one monotonic clock."""

    def __init__(self, per_s: float, now: float) -> None:
        self._per_s = per_s
        self._size = max(1.0, per_s)
        self._tokens = self._size
        self._at = now

    def wait_s(self, now: float, least: float = 0.0) -> float:
        """0 if one may be taken, or the seconds until then; ``least`` is the share that has to be left besides."""
        self._tokens = min(self._size, self._tokens + max(0.0, now - self._at) * self._per_s)
        self._at = now
        short = min(self._size, 1 + least * self._size) - self._tokens
        return short / self._per_s if short > ROUNDING else 0.0

    def take(self, now: float) -> float:
        """0 and a token is taken, or the seconds until there is one."""
        if wait_s := self.wait_s(now):
            return wait_s
        self._tokens -= 1
        return 0.0

    def spend(self, amount: float) -> None:
        """Take ``amount``, whatever is there: what is owed is waited for by those who come next."""
        self._tokens -= amount

    @property
    def spent(self) -> float:
        """The share that is gone, from 0 to 1, as of the last look."""
        return 1 - max(0.0, self._tokens) / self._size
