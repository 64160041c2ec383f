"""What is remembered for a while and within a bound: ended sessions, answered creations, tickets."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

V = TypeVar("V")


class Memory(Generic[V]):
    """At most ``most`` values by key, each for ``seconds`` or a time of its own; the oldest go first."""

    def __init__(self, most: int, seconds: float, clock: Callable[[], float]) -> None:
        self._most, self._seconds, self._clock = most, seconds, clock
        self._values: OrderedDict[str, tuple[float, V]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._values)

    def put(self, key: str, value: V, seconds: float | None = None) -> None:
        """Remember ``value``."""
        self._values[key] = (self._clock() + (self._seconds if seconds is None else seconds), value)
        self._values.move_to_end(key)
        while len(self._values) > self._most:
            self._values.popitem(last=False)

    def get(self, key: str) -> V | None:
        """The value, if it is still remembered."""
        until, value = self._values.get(key, (0.0, None))
        if value is not None and until < self._clock():
            del self._values[key]
            return None
        return value

    def pop(self, key: str) -> V | None:
        """The value, which is forgotten."""
        value = self.get(key)
        self._values.pop(key, None)
        return value

    def sweep(self) -> None:
        """Forget what is too old, from the oldest on."""
        now = self._clock()
        while self._values and next(iter(self._values.values()))[0] < now:
            self._values.popitem(last=False)
