"""Whose turn it is in a lane: start-time fair queueing over the time that each key has used."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class FairQueue(Generic[T]):
    """Items by key; the key that has used least time is next, and sleeping saves nothing up."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[T]] = {}
        self._used: dict[str, float] = {}
        self._now = 0.0

    def __len__(self) -> int:
        return sum(len(items) for items in self._waiting.values())

    def push(self, key: str, item: T) -> None:
        """Queue ``item`` behind those of the same key."""
        if key not in self._waiting:
            self._waiting[key] = deque()
            self._used[key] = max(self._used.get(key, 0.0), self._now)
        self._waiting[key].append(item)

    def pop(self) -> tuple[str, T] | None:
        """The next key and its item, or None."""
        if not self._waiting:
            return None
        key = min(self._waiting, key=self._used.__getitem__)
        self._now = self._used[key]
        items = self._waiting[key]
        item = items.popleft()
        if not items:
            del self._waiting[key]
        return key, item

    def charge(self, key: str, seconds: float) -> None:
        """Count time that ``key`` has used."""
        if key in self._used:
            self._used[key] += seconds

    def forget(self, key: str) -> list[T]:
        """Drop ``key``; its items that never had their turn."""
        self._used.pop(key, None)
        return list(self._waiting.pop(key, ()))
