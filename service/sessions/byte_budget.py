"""A budget for the bytes under way at once (bodies, messages, answers), shared fairly between owners."""

from __future__ import annotations

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError

ANONYMOUS = ""
"""The owner of bytes whose sender has not said yet who it is."""


class ByteBudget:
    """Counts the bytes that are held at once, up to a limit.

    An owner may hold at most as much as it leaves free: a single owner half of the limit, two owners a third each.
    So whoever comes next finds room, however much others hold.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.held = 0
        self._held_by: dict[str, int] = {}

    def change(self, owner: str, by: int) -> bool:
        """Hold ``by`` more bytes for ``owner``, fewer if negative. Return False, changing nothing, without room."""
        mine = self._held_by.get(owner, 0) + by
        held = self.held + by
        if by > 0 and mine > self.limit - held:
            return False
        self.held = held
        if mine:
            self._held_by[owner] = mine
        else:
            self._held_by.pop(owner, None)
        return True

    def transfer(self, source: str, target: str, size: int) -> None:
        """Count ``size`` bytes of one owner as another's, however much that one holds."""
        self.change(source, -size)
        self.held += size
        self._held_by[target] = self._held_by.get(target, 0) + size


class Reservation:
    """The bytes that one connection, call or stream holds of a budget.

    As many as ``elsewhere`` says are counted by another reservation, and not by this one.
    """

    __slots__ = ("_budget", "_held", "_owner", "elsewhere")

    def __init__(self, budget: ByteBudget, owner: str = ANONYMOUS) -> None:
        self._budget, self._owner, self._held = budget, owner, 0
        self.elsewhere = 0

    def assign(self, owner: str) -> None:
        """Count for ``owner`` from now on, including what is held already."""
        if self._held and owner != self._owner:
            self._budget.transfer(self._owner, owner, self._held)
        self._owner = owner

    def resize(self, size: int) -> bool:
        """Hold ``size`` bytes in all. Return False, and keep what was held, if they do not fit."""
        size = max(0, size - self.elsewhere)
        if size == self._held:
            return True
        if not self._budget.change(self._owner, size - self._held):
            return False
        self._held = size
        return True

    def grow(self, by: int) -> None:
        """Hold ``by`` bytes more. Raises at-capacity."""
        if not self.resize(self._held + by):
            raise ProblemError(ProblemCode.AT_CAPACITY, "too many bytes are under way at once", retry_after_s=1.0)

    def shrink(self, by: int) -> None:
        """Hold ``by`` bytes fewer."""
        self.resize(self._held - by)
