"""Start-time fair queueing: the order in which the calls of many keys enter a lane."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class FairQueue(Generic[T]):
    """Items by key. The key that has used the least time goes first; a key that pauses saves up no credit."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[T]] = {}
        self._used: dict[str, float] = {}
        self._now = 0.0

    def __len__(self) -> int:
        return sum(len(items) for items in self._waiting.values())

    @property
    def known(self) -> bool:
        """Whether there is a key that was seen and not forgotten."""
        return bool(self._used)

    def push(self, key: str, item: T) -> None:
        """Queue ``item`` behind those of the same key."""
        if key not in self._waiting:
            self._waiting[key] = deque()
            self._used[key] = max(self._used.get(key, 0.0), self._now)
        self._waiting[key].append(item)

    def pop(self) -> tuple[str, T] | None:
        """Remove the next item and return it with its key; None if no item waits."""
        if not self._waiting:
            return None
        key = min(self._waiting, key=self._used.__getitem__)
        self._now = self._used[key]
        return key, self.take(key)

    def take(self, key: str) -> T:
        """Remove and return the first item of ``key``, out of turn."""
        items = self._waiting[key]
        item = items.popleft()
        if not items:
            del self._waiting[key]
        return item

    def charge(self, key: str, seconds: float) -> None:
        """Count the seconds that ``key`` has used."""
        if key in self._used:
            self._used[key] += seconds

    def forget(self, key: str) -> list[T]:
        """Remove ``key`` and return its items that still waited."""
        self._used.pop(key, None)
        return list(self._waiting.pop(key, ()))


class FairOwnerQueue(Generic[T]):
    """Items by owner and key. Owners share time fairly, and the keys of an owner share its part fairly."""

    def __init__(self) -> None:
        self.waiting = 0
        """The number of items that wait."""
        self._owners: FairQueue[None] = FairQueue()  # one entry for each item of an owner
        self._keys: dict[str, FairQueue[T]] = {}

    def push(self, owner: str, key: str, item: T) -> None:
        """Queue ``item`` behind those of the same key."""
        self.waiting += 1
        self._owners.push(owner, None)
        keys = self._keys.get(owner)
        if keys is None:
            keys = self._keys[owner] = FairQueue()
        keys.push(key, item)

    def pop(self) -> T | None:
        """Remove and return the next item; None if no item waits."""
        turn = self._owners.pop()
        if turn is None:
            return None
        self.waiting -= 1
        found = self._keys[turn[0]].pop()
        assert found is not None
        return found[1]

    def charge(self, owner: str, key: str, seconds: float) -> None:
        """Count the seconds that ``key`` of ``owner`` has used."""
        self._owners.charge(owner, seconds)
        if owner in self._keys:
            self._keys[owner].charge(key, seconds)

    def forget(self, owner: str, key: str) -> list[T]:
        """Remove ``key``, and ``owner`` with its last key, and return the items that still waited."""
        if owner not in self._keys:
            return []
        keys = self._keys[owner]
        items = keys.forget(key)
        self.waiting -= len(items)
        for _ in items:
            self._owners.take(owner)
        if not keys.known:
            del self._keys[owner]
            self._owners.forget(owner)
        return items
