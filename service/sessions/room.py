"""The bytes that are under way at once: one budget for bodies, messages and answers, shared fairly by their owners."""

from __future__ import annotations

from ..problems import ProblemError

STRANGER = ""


class Room:
    """Bytes that are held at once, up to a limit.

    An owner may hold no more than it leaves free: one alone at most half, two a third each. So whoever comes
    next finds room, however much others hold.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.held = 0
        self._of: dict[str, int] = {}

    def change(self, owner: str, more: int) -> bool:
        """Hold ``more`` bytes for ``owner``, or fewer where it is negative; False, and nothing changes, if none fit."""
        mine = self._of.get(owner, 0) + more
        held = self.held + more
        if more > 0 and mine > self.limit - held:
            return False
        self.held = held
        if mine:
            self._of[owner] = mine
        else:
            self._of.pop(owner, None)
        return True

    def move(self, source: str, target: str, size: int) -> None:
        """Count ``size`` bytes of one owner as another's from now on, whatever that one holds."""
        self.change(source, -size)
        self.held += size
        self._of[target] = self._of.get(target, 0) + size


class Share:
    """What one connection, call or stream holds of the room."""

    __slots__ = ("_held", "_owner", "_room")

    def __init__(self, room: Room, owner: str = STRANGER) -> None:
        self._room, self._owner, self._held = room, owner, 0

    def belong(self, owner: str) -> None:
        """Count for ``owner`` from now on, what is held already included."""
        if self._held and owner != self._owner:
            self._room.move(self._owner, owner, self._held)
        self._owner = owner

    def hold(self, size: int) -> bool:
        """Hold ``size`` bytes in all; False, and what was held stays held, if they do not fit."""
        if size == self._held:
            return True
        if not self._room.change(self._owner, size - self._held):
            return False
        self._held = size
        return True

    def take(self, size: int) -> None:
        """Hold so many more. Raises at-capacity."""
        if not self.hold(self._held + size):
            raise ProblemError("at-capacity", "too much is under way at once", retry_after_s=1.0)

    def give(self, size: int) -> None:
        """Hold so many less."""
        self.hold(self._held - size)
