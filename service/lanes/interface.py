"""What the front knows of lanes: bytes in, bytes out. A local pool implements it today, a cluster may."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import Protocol

Buffers = Sequence[bytes | memoryview]


class AtCapacity(Exception):
    """No lane has a free place now."""


class LaneLost(Exception):
    """A call was not answered, and what the lane held for its key is gone.

    ``cause``: the lane ``died``, ``hung`` past the deadline or outgrew its ``memory``; the key was
    ``released``, or has no lane now (``absent``). ``in_work``: the lane was at this very call.
    """

    def __init__(self, cause: str, *, in_work: bool = False) -> None:
        super().__init__(cause)
        self.cause, self.in_work = cause, in_work


@dataclass(frozen=True, slots=True)
class Place:
    """In which lane a key is, and what became of its lane before: as in LaneLost, ``restart`` if it had none
    here, nothing if it is the same."""

    lane: int
    cause: str


@dataclass(frozen=True, slots=True)
class KeysLost:
    """An event: a lane has died, and with it what it held for these keys."""

    lane: int
    cause: str
    keys: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LaneReady:
    """An event: a lane has started and takes keys; ``confined`` is what it has given up (see ``confine``)."""

    lane: int
    confined: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LaneCrowded:
    """An event: ``key`` would go on better in ``lane``, which has time to spare when its own has not."""

    key: str
    lane: int


LaneEvent = KeysLost | LaneReady | LaneCrowded


@dataclass(frozen=True, slots=True)
class LaneStatus:
    """A lane as the front sees it at any moment; ``failing``: it dies again and again."""

    lane: int
    ready: bool
    failing: bool
    keys: int
    versions: dict[str, str]


@dataclass(frozen=True, slots=True)
class LaneUsage:
    """What a lane's process uses: resident memory, and CPU time since it started."""

    lane: int
    rss_bytes: int
    cpu_s: float


class Lanes(Protocol):
    """A set of lanes; a key (a session) lives in one of them from ``reserve`` to ``release``.

    Keys have an owner: lanes share their time between owners first, then between the keys of one.
    """

    async def start(self) -> None:
        """Begin to start all lanes; events tell when they are ready."""

    async def stop(self) -> None:
        """End all lanes."""

    def reserve(self, key: str, owner: str) -> None:
        """Give ``key`` a place in the lane with the most time to spare, now or never. Raises AtCapacity."""

    def move(self, key: str, lane: int) -> bool:
        """Give ``key`` a place in that lane instead; its own forgets it. False, and nothing done, without room."""

    async def regain(self, key: str, owner: str) -> Place:
        """Give ``key``, whose lane was lost, a place again, when there is one. Raises LaneLost if it is released."""

    def holds(self, key: str) -> bool:
        """Whether ``key`` has a place in a lane."""

    async def call(self, key: str, request: Buffers) -> bytes | memoryview:
        """One operation in the key's lane: a MessagePack value there and one back, in the order of calls.

        Raises LaneLost. Calls of different owners, and of different keys of one, share a lane's time fairly.
        """

    def release(self, key: str) -> None:
        """Free the key's place at once; its lane forgets it before it takes another."""

    def events(self) -> AsyncIterator[LaneEvent]:
        """What happens to lanes, as it happens; for one reader."""

    def status(self) -> list[LaneStatus]:
        """Every lane."""

    def usage(self) -> list[LaneUsage]:
        """What every lane uses; asks the system, so not for every call."""
