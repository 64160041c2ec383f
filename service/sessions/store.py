"""Brings sessions back: after the loss of a lane from memory, and after the end of the process from disk."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Self

import structlog

from ..lanes.interface import Lanes
from ..observability.metrics import Metrics
from ..protocol.enums import EndReason
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from ..protocol.target import Row
from ..settings import Settings
from .database import Ended, SavedSession, SessionDatabase
from .lane_state import LaneState, RestoreSlots
from .replay_log import RecoveryBudget
from .session import Session
from .sqlite_store import SqliteStore

# The order of the options in version 1 of the state directory.
OPTIONS_OF_VERSION_1 = ("preset", "on_resize", "label", "maps", "idle_timeout_s")

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.recovery")


@dataclass(frozen=True, slots=True)
class SessionRecord:
    """What the front saves of a session, by name. A field that is added has a default, for records before it."""

    options: Options
    created_at: datetime
    seq: int
    last_number: int
    size: list[int]
    region: list[int] | None
    rows: list[Row]

    @classmethod
    def of(cls, session: Session) -> Self:
        """Return the record of a session as it is now."""
        return cls(
            session.options,
            session.created_at,
            session.seq,
            session.last_number,
            session.size,
            session.region,
            session.rows,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain values."""
        return {name: getattr(self, name) for name in self.__slots__} | {
            "options": asdict(self.options),
            "created_at": self.created_at.isoformat(),
        }

    @classmethod
    def from_dict(cls, saved: dict[str, Any]) -> Self:
        """Return the record that :meth:`to_dict` wrote, in this version or an earlier one."""
        options = saved["options"]
        if isinstance(options, list):
            options = dict(zip(OPTIONS_OF_VERSION_1, options, strict=True))
        created_at = datetime.fromisoformat(saved["created_at"])
        return cls(**saved | {"options": Options(**options), "created_at": created_at})


class SessionStore:
    """Keeps replay logs in memory, within one budget, and saves sessions to the database, if there is one.

    ``database`` is that of several nodes; by default it is the state directory, if one is set.
    """

    def __init__(
        self,
        settings: Settings,
        lanes: Lanes,
        metrics: Metrics,
        owners: Callable[[], int],
        database: SessionDatabase | None = None,
    ) -> None:
        self.budget = RecoveryBudget(settings.max_recovery_bytes, owners)
        self._settings, self._lanes, self._metrics = settings, lanes, metrics
        self._restore_slots = RestoreSlots()
        if database is None and settings.state_dir:
            database = SqliteStore(Path(settings.state_dir), metrics)
        self._database = database
        self.all_written = True
        """False if some session could not be written when the service stopped."""

    @property
    def durable(self) -> bool:
        """Whether sessions outlive the process."""
        return self._database is not None

    def lane_state(self, sid: str, owner: str) -> LaneState:
        """Return the lane state of a new session."""
        return LaneState(sid, owner, self._lanes, self._restore_slots, self.budget, self._settings, self._metrics)

    def open(self) -> None:
        """Open the database, if there is one. Raises StateError."""
        if self._database is not None:
            self._database.open()

    def take_over(self) -> None:
        """Open the database and take over its sessions, if there is one. Raises StateError."""
        if self._database is not None:
            self._database.take_over()

    def load(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """Return, once, the sessions that another process has left, and the ids and owners of damaged ones."""
        return self._database.load() if self._database else ([], [])

    def save(self, session: Session, *, whole: bool = False) -> None:
        """Save the session as of its newest checkpoint; ``whole`` says that nothing happens to it after that."""
        checkpoint = session.lane.replay_log.checkpoint
        if self._database is None or checkpoint is None or session.ended or session.handed_over:
            return
        trajectory = session.trajectory
        entries = deque(trajectory.newest(session.saved_to))
        session.saved_to = session.seq
        front = SessionRecord.of(session).to_dict()
        first, epoch = trajectory.first_seq, session.epoch
        keep_s = self.keep_s(session)
        self._database.save(
            SavedSession(session.id, session.owner, front, checkpoint, entries, first, whole, epoch, keep_s)
        )

    def keep_s(self, session: Session) -> float:
        """Return for how long a saved session may be needed, if nobody uses it before."""
        assert session.options.idle_timeout_s is not None
        return max(session.options.idle_timeout_s, self._settings.attached_idle_timeout_s)

    def restore_into(self, session: Session, saved: SavedSession, record: SessionRecord) -> None:
        """Make a new session what the saved one was. Its state comes back when it gets a lane."""
        session.seq, session.last_number = record.seq, record.last_number
        session.size, session.region, session.rows = record.size, record.region, record.rows
        for seq, entry in saved.entries:
            session.trajectory.append_packed(seq, entry)
        session.saved_to, session.epoch = session.seq, saved.epoch
        session.lost_after = None if saved.whole else session.seq
        session.lane.replay_log.reset_to(saved.checkpoint)

    def delete(self, session: Session) -> None:
        """Delete what is kept of a session that has ended."""
        session.lane.replay_log.close()
        if self._database is not None:
            reason = session.ended or EndReason.LOST
            self._database.delete(session.id, Ended(session.owner, session.epoch, reason))

    async def save_whole(self, session: Session) -> bool:
        """Save a session as it is when its work in flight is done; return whether that is written."""
        assert self._database is not None
        whole = await self._save_whole(session)
        return whole and await asyncio.to_thread(self._database.flush, self._settings.operation_deadline_s, session.id)

    async def save_all(self, sessions: Iterable[Session]) -> None:
        """Save all sessions as they are when their work in flight is done, and close the database."""
        if self._database is None:
            return
        sessions = list(sessions)
        whole = await asyncio.gather(*(self._save_whole(session) for session in sessions))
        await asyncio.to_thread(self._database.flush, self._settings.operation_deadline_s)
        self.all_written = await asyncio.to_thread(self._database.close)
        write_log = log.info if self.all_written and all(whole) else log.error
        write_log("sessions saved", sessions=len(sessions), whole=sum(whole), written=self.all_written)

    async def _save_whole(self, session: Session) -> bool:
        """Save a session as it is now, and return whether that was possible."""
        try:
            async with asyncio.timeout(2 * self._settings.operation_deadline_s):
                await session.prepare_to_stop()
        except (ProblemError, TimeoutError):
            return False  # the session will go on from its newest checkpoint
        # What was lost before stays lost until the client has been told and a frame is tracked.
        self.save(session, whole=session.lost_after is None)
        return True
