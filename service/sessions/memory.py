"""What is remembered for a while and within a bound: ended sessions, answered creations, tickets."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

V = TypeVar("V")


class Memory(Generic[V]):
    """At most ``most`` values of each owner by key, each for ``seconds`` or a time of its own.

    An owner's oldest values make room for its newer ones; what others do takes nothing away from it.
    """

    def __init__(self, most: int, seconds: float, clock: Callable[[], float]) -> None:
        self._most, self._seconds, self._clock = most, seconds, clock
        self._values: dict[str, tuple[float, str, V]] = {}
        self._owned: dict[str, OrderedDict[str, None]] = {}

    def __len__(self) -> int:
        return len(self._values)

    def put(self, owner: str, key: str, value: V, seconds: float | None = None) -> None:
        """Remember ``value`` under a key that no other owner uses."""
        until = self._clock() + (self._seconds if seconds is None else seconds)
        self._values[key] = until, owner, value
        keys = self._owned.setdefault(owner, OrderedDict())
        keys[key] = None
        keys.move_to_end(key)
        if len(keys) > self._most:
            self.pop(next(iter(keys)))

    def get(self, key: str) -> V | None:
        """The value, if it is still remembered."""
        known = self._values.get(key)
        if known is None:
            return None
        if known[0] < self._clock():
            self.pop(key)
            return None
        return known[2]

    def pop(self, key: str) -> V | None:
        """The value, if it is still remembered; from now on it is forgotten."""
        known = self._values.pop(key, None)
        if known is None:
            return None
        until, owner, value = known
        keys = self._owned[owner]
        del keys[key]
        if not keys:
            del self._owned[owner]
        return None if until < self._clock() else value

    def sweep(self) -> None:
        """Forget what is too old, of each owner from the oldest on."""
        now = self._clock()
        for keys in list(self._owned.values()):
            while keys and self._values[oldest := next(iter(keys))][0] < now:
                self.pop(oldest)
