"""A cache whose values expire, with a bound for each owner: ended sessions, answered creations, tickets."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

V = TypeVar("V")


class TTLCache(Generic[V]):
    """Holds at most ``limit`` values of each owner, each for ``ttl_s`` seconds unless :meth:`put` says otherwise.

    An owner's newest values push out its own oldest ones, never another owner's. Keys are unique among all owners.
    """

    def __init__(self, limit: int, ttl_s: float, clock: Callable[[], float]) -> None:
        self._limit, self._ttl_s, self._clock = limit, ttl_s, clock
        self._values: dict[str, tuple[float, str, V]] = {}
        self._keys: dict[str, OrderedDict[str, None]] = {}

    def __len__(self) -> int:
        return len(self._values)

    def put(self, owner: str, key: str, value: V, ttl_s: float | None = None) -> None:
        """Keep ``value`` under a key that no other owner uses."""
        expires = self._clock() + (self._ttl_s if ttl_s is None else ttl_s)
        self._values[key] = expires, owner, value
        keys = self._keys.setdefault(owner, OrderedDict())
        keys[key] = None
        keys.move_to_end(key)
        if len(keys) > self._limit:
            self.pop(next(iter(keys)))

    def get(self, key: str) -> V | None:
        """Return the value, or None if there is none or it has expired."""
        known = self._values.get(key)
        if known is None:
            return None
        if known[0] < self._clock():
            self.pop(key)
            return None
        return known[2]

    def pop(self, key: str) -> V | None:
        """Remove the value and return it, or None if there is none or it has expired."""
        known = self._values.pop(key, None)
        if known is None:
            return None
        expires, owner, value = known
        keys = self._keys[owner]
        del keys[key]
        if not keys:
            del self._keys[owner]
        return None if expires < self._clock() else value

    def sweep(self) -> None:
        """Remove what has expired, of each owner from the oldest on."""
        now = self._clock()
        for keys in list(self._keys.values()):
            while keys and self._values[oldest := next(iter(keys))][0] < now:
                self.pop(oldest)
