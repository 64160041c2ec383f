"""Balance between lanes: how much of its lane each key has used of late, and which key should move."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import exp

# Time constant of the average: use that is this old counts for about a third (1/e) of new use.
MEMORY_S = 3.0
# A key moves if its lane is busy for at least FULL of the time and another for at most IDLE of it,
FULL, IDLE = 0.9, 0.4
# and if the move makes the busier of the two less busy by at least this.
LEAST_GAIN = 0.02
# After a move, both lanes and the key take no part in another for these times.
LANES_REST_S, KEY_RESTS_S = 10.0, 60.0
# A key that used less than this is forgotten.
NOTHING = 0.001


class RecentUsage:
    """The share of a lane's time that each key has used of late, from 0 to 1."""

    def __init__(self, now: float) -> None:
        self._parts: dict[str, float] = {}
        self._used: dict[str, float] = {}
        self._since = now

    def add(self, key: str, seconds: float) -> None:
        """Count the seconds for which ``key`` has used a lane."""
        self._used[key] = self._used.get(key, 0.0) + seconds

    def part(self, key: str) -> float:
        """Return the share that ``key`` has used."""
        return self._parts.get(key, 0.0)

    def parts(self) -> Iterable[tuple[str, float]]:
        """Return every key that has used any time, and its share."""
        return self._parts.items()

    def forget(self, key: str) -> None:
        """Remove a key that has ended."""
        self._parts.pop(key, None)
        self._used.pop(key, None)

    def update(self, now: float) -> None:
        """Bring the shares up to date with what was counted since the last call."""
        passed = now - self._since
        if passed <= 0:
            return
        self._since = now
        kept = exp(-passed / MEMORY_S)
        rest = {}
        for key in self._parts.keys() | self._used.keys():
            used = self._used.get(key, 0.0)
            if used > passed:  # one long operation, counted at its end
                rest[key] = used - passed
            part = self._parts.get(key, 0.0) * kept + min(1.0, used / passed) * (1 - kept)
            if part < NOTHING:
                self._parts.pop(key, None)
            else:
                self._parts[key] = part
        self._used = rest


class Rebalancer:
    """Chooses which key should move to which lane, one at a time, and lets both lanes settle in between."""

    def __init__(self) -> None:
        # The lanes and keys that rest, and until when.
        self._lanes: dict[int, float] = {}
        self._keys: dict[str, float] = {}

    def choose(self, parts: Sequence[Mapping[str, float]], room: Iterable[int], now: float) -> tuple[str, int] | None:
        """Return a key and the lane that it should move to, or None.

        Parameters
        ----------
        parts
            For each lane, the share of its time that each of its keys uses.
        room
            The lanes that can take one more key.
        now
            Seconds of a monotonic clock.
        """
        self._forget(now)
        busy = [sum(lane.values()) for lane in parts]
        ready = [lane for lane in room if busy[lane] <= IDLE and lane not in self._lanes]
        full = [lane for lane in range(len(parts)) if busy[lane] >= FULL and lane not in self._lanes]
        if not ready or not full:
            return None
        crowded, idle = max(full, key=busy.__getitem__), min(ready, key=busy.__getitem__)

        # The load of the busier of both lanes after each move; of equal ones, the move of the smallest share.
        moves = [
            (round(max(busy[crowded] - part, busy[idle] + part), 2), part, key)
            for key, part in parts[crowded].items()
            if key not in self._keys
        ]
        fuller, _, key = min(moves, default=(busy[crowded], 0.0, ""))
        if fuller > busy[crowded] - LEAST_GAIN:
            return None
        self._lanes |= {crowded: now + LANES_REST_S, idle: now + LANES_REST_S}
        self._keys[key] = now + KEY_RESTS_S
        return key, idle

    def _forget(self, now: float) -> None:
        self._lanes = {lane: until for lane, until in self._lanes.items() if until > now}
        self._keys = {key: until for key, until in self._keys.items() if until > now}
