"""What brings sessions back: after the loss of a lane, and of the whole process."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

import structlog

from ..lanes.interface import Lanes
from ..observability.metrics import Metrics
from ..protocol.problems import ProblemError
from ..settings import Settings
from .lane_state import LaneState, RestoreSlots
from .replay_log import RecoveryBudget
from .session import Options, Session
from .sqlite_store import SavedSession, SqliteStore

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.recovery")


class SessionStore:
    """Journals in memory, within one budget; sessions on disk where a state directory is set."""

    def __init__(self, settings: Settings, lanes: Lanes, metrics: Metrics) -> None:
        self.budget = RecoveryBudget(settings.max_recovery_bytes)
        self._settings, self._lanes, self._metrics = settings, lanes, metrics
        self._restore_slots = RestoreSlots()
        self._database = SqliteStore(Path(settings.state_dir), metrics) if settings.state_dir else None
        self.all_written = True
        """False once sessions could not be written when the service stopped."""

    @property
    def durable(self) -> bool:
        """Whether sessions outlive the process."""
        return self._database is not None

    def lane_state(self, sid: str, owner: str) -> LaneState:
        """The lane side of a new session."""
        return LaneState(sid, owner, self._lanes, self._restore_slots, self.budget, self._settings, self._metrics)

    def open(self) -> None:
        """Open the state directory, where there is one. Raises StateDirError."""
        if self._database is not None:
            self._database.open()

    def take_over(self) -> None:
        """Take over what the state directory holds, where there is one; opens it too. Raises StateDirError."""
        if self._database is not None:
            self._database.take_over()

    def load(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """What another process has left: sessions, and ids and owners of damaged ones; once."""
        return self._database.load() if self._database else ([], [])

    def save(self, session: Session, *, whole: bool = False) -> None:
        """The session can be brought back as it is now; ``whole``: and nothing more will happen to it here."""
        base = session.lane.replay_log.checkpoint
        if self._database is None or base is None or session.ended:
            return
        options = session.options
        front = {
            "options": [options.preset, options.on_resize, options.label, options.maps, options.idle_timeout_s],
            "created_at": session.created_at.isoformat(),
            "seq": session.seq,
            "last_number": session.last_number,
            "size": session.size,
            "region": session.region,
            "rows": session.rows,
        }
        trajectory = session.trajectory
        entries = deque(trajectory.newest(session.saved_to))
        session.saved_to = session.seq
        self._database.save(SavedSession(session.id, session.owner, front, base, entries, trajectory.first_seq, whole))

    def restore_into(self, session: Session, saved: SavedSession) -> None:
        """Make a new session what the saved one was; its state comes back with its lane."""
        front = saved.front
        session.seq, session.last_number = front["seq"], front["last_number"]
        session.size, session.region, session.rows = front["size"], front["region"], front["rows"]
        for seq, entry in saved.entries:
            session.trajectory.append_packed(seq, entry)
        session.saved_to = session.seq
        session.lost_after = None if saved.whole else session.seq
        session.lane.replay_log.reset_to(saved.base)

    def delete(self, session: Session) -> None:
        """The session has ended."""
        session.lane.replay_log.close()
        if self._database is not None:
            self._database.delete(session.id)

    async def save_all(self, sessions: Iterable[Session]) -> None:
        """Write all sessions as they are when their work in flight is done, and close the state directory."""
        if self._database is None:
            return
        sessions = list(sessions)
        results = await asyncio.gather(*(self._park(session) for session in sessions))
        await asyncio.to_thread(self._database.flush, self._settings.operation_deadline_s)
        self.all_written = await asyncio.to_thread(self._database.close)
        told = log.info if self.all_written and all(results) else log.error
        told("sessions parked", sessions=len(sessions), whole=sum(results), written=self.all_written)

    async def _park(self, session: Session) -> bool:
        try:
            async with asyncio.timeout(2 * self._settings.operation_deadline_s):
                await session.park()
        except (ProblemError, TimeoutError):
            return False  # it will go on from its last checkpoint
        # What was lost before stays lost until its client has been told and a frame is tracked.
        self.save(session, whole=session.lost_after is None)
        return True


def options_of(saved: SavedSession) -> Options:
    """What the client of a saved session chose."""
    return Options(*saved.front["options"])


def created_at_of(saved: SavedSession) -> datetime:
    """When a saved session was made."""
    return datetime.fromisoformat(saved.front["created_at"])
