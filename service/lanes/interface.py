"""The lanes as the front sees them: bytes in, bytes out. A local pool implements this; a cluster could."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Sequence
from dataclasses import dataclass
from typing import Protocol

from ..protocol.enums import LaneLoss

Buffers = Sequence[bytes | memoryview]


class AtCapacity(Exception):
    """No lane has a free place at the moment."""


class LaneLost(Exception):
    """A call was not answered, and the state that the lane held for its key is gone.

    ``cause`` is ``died``, ``hung`` (the deadline passed), ``memory`` (the lane outgrew its limit), ``released`` (the
    key was) or ``absent`` (the key has no lane). ``in_work`` is True if the lane was working on this very call.
    """

    def __init__(self, cause: LaneLoss, *, in_work: bool = False) -> None:
        super().__init__(cause)
        self.cause, self.in_work = cause, in_work


@dataclass(frozen=True, slots=True)
class Place:
    """The lane of a key, and why it lost the one before.

    ``cause`` is as in :class:`LaneLost`, ``restart`` for a key of an earlier process, or empty if the lane is the same.
    """

    lane: int
    cause: str


@dataclass(frozen=True, slots=True)
class KeysLost:
    """An event: a lane has died, and the state that it held for these keys is gone."""

    lane: int
    cause: LaneLoss
    keys: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LaneReady:
    """An event: a lane has started and takes keys; ``confined`` names the rights that it gave up."""

    lane: int
    confined: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LaneCrowded:
    """An event: ``key`` should move to ``lane``, which has time to spare while its own has none."""

    key: str
    lane: int


LaneEvent = KeysLost | LaneReady | LaneCrowded


@dataclass(frozen=True, slots=True)
class LaneStatus:
    """The state of a lane; ``failing`` is True if it dies again and again."""

    lane: int
    ready: bool
    failing: bool
    keys: int
    versions: dict[str, str]


@dataclass(frozen=True, slots=True)
class LaneUsage:
    """The resident memory of a lane's process, and its CPU time since it started."""

    lane: int
    rss_bytes: int
    cpu_s: float


class Lanes(Protocol):
    """A set of lanes. A key (a session) has a place in one of them from ``reserve`` to ``release``.

    Keys have owners: a lane shares its time fairly between owners, and then between the keys of each.
    """

    async def start(self) -> None:
        """Begin to start all lanes; :meth:`events` yields when they are ready."""

    async def stop(self) -> None:
        """End all lanes."""

    def reserve(self, key: str, owner: str) -> None:
        """Give ``key`` a place in the lane with the most time to spare. Raises AtCapacity if there is none now."""

    def move(self, key: str, lane: int) -> bool:
        """Move the place of ``key`` to ``lane`` and drop its state. Return False, changing nothing, without room."""

    async def regain(self, key: str, owner: str) -> Place:
        """Wait for a new place for ``key``, whose lane was lost. Raises LaneLost if the key is released."""

    def holds(self, key: str) -> bool:
        """Return whether ``key`` has a place in a lane."""

    def call(self, key: str, request: Buffers) -> Awaitable[bytes | memoryview]:
        """Do one operation in the key's lane: send a MessagePack value and return the reply. Raises LaneLost.

        The calls of one key are done in their order. Owners, and the keys of each, share a lane's time fairly.
        """

    def release(self, key: str) -> None:
        """Free the key's place at once; its lane drops the state before it does anything for another key."""

    def events(self) -> AsyncIterator[LaneEvent]:
        """Yield what happens to lanes, as it happens; for one reader."""

    def status(self) -> list[LaneStatus]:
        """Return the state of every lane."""

    def usage(self) -> list[LaneUsage]:
        """Return what every lane uses. This asks the operating system, so it is not for every call."""
