"""How the work is spread over lanes: what each key has used of its lane lately, and which one should move."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import exp

# How far back "lately" reaches: what is this old counts for a third of what is new.
MEMORY_S = 3.0
# A key moves when its lane is so full and another so idle,
FULL, IDLE = 0.9, 0.4
# if the fuller of both lanes is the less full for it by this at least.
LEAST_GAIN = 0.02
# After a move both lanes settle for so long, and the key stays where it is for so long.
LANES_REST_S, KEY_RESTS_S = 10.0, 60.0
# A key that used less than this is forgotten.
NOTHING = 0.001


class RecentUsage:
    """The part of a lane's time that each key has used of late, from 0 to 1."""

    def __init__(self, now: float) -> None:
        self._parts: dict[str, float] = {}
        self._used: dict[str, float] = {}
        self._since = now

    def add(self, key: str, seconds: float) -> None:
        """``key`` has used a lane for so long."""
        self._used[key] = self._used.get(key, 0.0) + seconds

    def part(self, key: str) -> float:
        """The part that ``key`` has used."""
        return self._parts.get(key, 0.0)

    def parts(self) -> Iterable[tuple[str, float]]:
        """Every key that has used any, and its part."""
        return self._parts.items()

    def forget(self, key: str) -> None:
        """``key`` has ended."""
        self._parts.pop(key, None)
        self._used.pop(key, None)

    def update(self, now: float) -> None:
        """Take in what was used since this was last called."""
        passed = now - self._since
        if passed <= 0:
            return
        self._since = now
        kept = exp(-passed / MEMORY_S)
        rest = {}
        for key in self._parts.keys() | self._used.keys():
            used = self._used.get(key, 0.0)
            if used > passed:  # one long operation, told at its end
                rest[key] = used - passed
            part = self._parts.get(key, 0.0) * kept + min(1.0, used / passed) * (1 - kept)
            if part < NOTHING:
                self._parts.pop(key, None)
            else:
                self._parts[key] = part
        self._used = rest


class Rebalancer:
    """Chooses which key should go where, one at a time, and lets things settle in between."""

    def __init__(self) -> None:
        # What rests, and until when.
        self._lanes: dict[int, float] = {}
        self._keys: dict[str, float] = {}

    def choose(self, parts: Sequence[Mapping[str, float]], room: Iterable[int], now: float) -> tuple[str, int] | None:
        """A key and the lane that it should go on in, or None.

        ``parts`` holds for each lane the part that each of its keys uses, ``room`` the lanes that can take one more.
        """
        self._forget(now)
        busy = [sum(lane.values()) for lane in parts]
        ready = [lane for lane in room if busy[lane] <= IDLE and lane not in self._lanes]
        full = [lane for lane in range(len(parts)) if busy[lane] >= FULL and lane not in self._lanes]
        if not ready or not full:
            return None
        crowded, idle = max(full, key=busy.__getitem__), min(ready, key=busy.__getitem__)

        # How full the fuller of both lanes is after each move; of moves that come to the same, the smallest.
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
