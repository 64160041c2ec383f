"""The registry of sessions: finds, makes and ends them, and remembers for a while those that have ended."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial

import structlog

from ..lanes.interface import KeysLost, LaneCrowded, Lanes
from ..observability.metrics import Metrics
from ..protocol.answers import Draining, message
from ..protocol.enums import CloseCode, EndReason, ProblemCode
from ..protocol.problems import ProblemError, session_gone, session_not_found
from ..protocol.requests import Options
from ..settings import Settings
from .admission import Admission, KeyQuotas
from .database import SavedSession
from .idempotency import IdempotentCreations
from .interface import AttachedStream, SharedNode
from .session import Session
from .store import SessionRecord, SessionStore
from .ttl_cache import TTLCache

SWEEP_EVERY_S = 0.5
ID_BYTES = 18
CLOSE_OF_END = {
    EndReason.CLOSED: CloseCode.SESSION_CLOSED,
    EndReason.IDLE: CloseCode.IDLE,
    EndReason.EXPIRED: CloseCode.SESSION_GONE,
    EndReason.LOST: CloseCode.SESSION_GONE,
}
"""How a stream is closed when its session ends."""

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.sessions")


@dataclass(frozen=True, slots=True)
class Tombstone:
    """Says of a session that has ended whose it was and why it ended."""

    owner: str
    reason: EndReason
    detail: str = ""


class SessionRegistry:
    """All sessions of the service.

    Parameters
    ----------
    settings, lanes, metrics
        Those of the service.
    clock
        Returns the seconds of a monotonic clock.
    owners
        Returns the number of owners that the keys stand for.
    node
        What this node has to do with others that share a store; None where it is the only one.
    """

    def __init__(
        self,
        settings: Settings,
        lanes: Lanes,
        metrics: Metrics,
        clock: Callable[[], float] = time.monotonic,
        owners: Callable[[], int] = lambda: 1,
        node: SharedNode | None = None,
    ) -> None:
        self.quotas = KeyQuotas(settings, owners)
        self.store = SessionStore(settings, lanes, metrics, owners, node.database if node else None)
        self._node = node
        self._settings, self._lanes, self._metrics, self._clock = settings, lanes, metrics, clock
        self._sessions: dict[str, Session] = {}
        self._admission = Admission(
            settings, lanes, metrics, self.quotas, self.store, self._sessions, self.sweep, self._seconds_left
        )
        self._tombstones: TTLCache[Tombstone] = TTLCache(settings.max_tombstones, settings.tombstone_s, clock)
        self._creations = IdempotentCreations(settings.max_idempotency_keys, settings.idempotency_s, clock)
        self._ordinal = 0

    def __len__(self) -> int:
        return len(self._sessions)

    @property
    def draining(self) -> bool:
        """Whether new sessions are refused because the service is going away."""
        return self._admission.draining

    def living(self) -> dict[str, Session]:
        """Return the sessions that are here, by their ids."""
        return dict(self._sessions)

    def here(self, sid: str) -> Session | None:
        """Return a session if it is here, whoever asks."""
        return self._sessions.get(sid)

    def find(self, owner: str, sid: str) -> Session:
        """Return the caller's session and count it as used. Raises session-not-found, session-gone."""
        session = self._sessions.get(sid)
        if session is None or session.owner != owner:
            tombstone = self._tombstones.get(sid)
            if tombstone is None or tombstone.owner != owner:
                raise session_not_found()
            raise session_gone(tombstone.reason, tombstone.detail)
        if (reason := self._overdue(session)) is not None:
            self.end(session, reason)
            return self.find(owner, sid)
        session.touch()
        return session

    def list_owned(self, owner: str, after: int, limit: int) -> tuple[list[Session], int | None]:
        """Return a page of the caller's sessions, oldest first, and the number after which the next page begins."""
        mine = [s for s in self._sessions.values() if s.owner == owner and s.ordinal > after]
        page = mine[:limit]
        return page, page[-1].ordinal if len(mine) > limit else None

    def labelled(self, owner: str, label: str) -> Session | None:
        """Return the newest of the caller's sessions with this label, None if there is none."""
        mine = (s for s in reversed(self._sessions.values()) if s.owner == owner and s.options.label == label)
        return next(mine, None)

    async def create(
        self, owner: str, data: bytes | memoryview, boxes: list[list[float]], options: Options, key: str | None
    ) -> Session:
        """Return a session that has started on its first frame; for the same ``key`` and content, the same one."""

        async def make() -> str:
            session = self._new(owner, options)
            async with self._placed(session):
                await session.start(data, boxes)
            return session.id

        return self.find(owner, await self._once(owner, key, data, repr((boxes, options)), make))

    async def repeated(
        self, owner: str, data: bytes | memoryview, boxes: list[list[float]], options: Options, key: str | None
    ) -> asyncio.Future[str] | None:
        """Return the future of the session that :meth:`create` makes or made for this key; None for the first call.

        Raises bad-request for a key that came before with other content.
        """
        return await self._creations.repeated(owner, key, data, repr((boxes, options)))

    async def restore(self, owner: str, snapshot: bytes | memoryview, key: str | None) -> Session:
        """Return a session with a new id that goes on from a snapshot; for the same ``key``, the same one."""

        async def make() -> str:
            session = self._new(owner, Options())
            async with self._placed(session):
                options = await session.restore(snapshot)
                session.options = self._within_limits(options)
                self.store.save(session)
            return session.id

        return self.find(owner, await self._once(owner, key, snapshot, "snapshot", make))

    def close(self, owner: str, sid: str) -> None:
        """End the caller's session, if it has not ended yet. Raises session-not-found."""
        try:
            session = self.find(owner, sid)
        except ProblemError as gone:
            if gone.code != ProblemCode.SESSION_GONE:
                raise
        else:
            self.end(session, EndReason.CLOSED)

    def end(self, session: Session, reason: EndReason, detail: str = "") -> None:
        """End a session and its stream."""
        session.ended = reason
        self._sessions.pop(session.id, None)
        self._lanes.release(session.id)
        self.store.delete(session)
        self._tombstones.put(session.owner, session.id, Tombstone(session.owner, reason, detail))
        self._metrics.sessions_closed.labels(reason=reason).inc()
        log.info("session ended", session=session.id, reason=reason, detail=detail, seq=session.seq)
        if session.attachment is not None:
            session.attachment.end(CLOSE_OF_END[reason], f"session ended: {detail or reason}")

    def expires_at(self, session: Session) -> datetime:
        """Return when the session ends if it is not used again."""
        return datetime.now(UTC) + timedelta(seconds=self._seconds_left(session))

    async def load(self) -> None:
        """Take over the sessions that another process has left. Raises StateError."""
        await asyncio.to_thread(self.store.take_over)
        saved, damaged = self.store.load()
        for one in saved:
            self.take_up(one)
        for sid, owner in damaged:
            self.bury(owner, sid, EndReason.LOST, "its saved state is damaged")
        if saved or damaged:
            whole = sum(one.whole for one in saved)
            log.info("sessions loaded", sessions=len(saved), whole=whole, damaged=len(damaged))

    def take_up(self, saved: SavedSession) -> None:
        """Go on with a session that another process has saved."""
        record = SessionRecord.from_dict(saved.front)
        session = self._new(saved.owner, self._within_limits(record.options), saved.id, record.created_at)
        self.store.restore_into(session, saved, record)
        self._sessions[saved.id] = session
        session.restore_lane_state()

    def bury(self, owner: str, sid: str, reason: EndReason, detail: str = "") -> None:
        """Remember of a session that is not here how it ended."""
        self._tombstones.put(owner, sid, Tombstone(owner, reason, detail))

    def let_go(self, session: Session, why: str) -> None:
        """Forget a session with which another node goes on."""
        session.handed_over = True
        self._sessions.pop(session.id, None)
        self._lanes.release(session.id)
        session.lane.replay_log.close()
        log.info("session goes on elsewhere", session=session.id, why=why, seq=session.seq)
        if session.attachment is not None:
            session.attachment.end(CloseCode.RESTART, why)

    async def save_all(self) -> None:
        """Write all sessions to the database, if there is one."""
        await self.store.save_all(self._sessions.values())

    def drain(self, reconnect_in_s: Callable[[], float]) -> None:
        """Refuse new sessions, tell every stream, and finish those streams whose sessions outlive the process."""
        self._admission.draining = True
        for session in list(self._sessions.values()):
            url = self._node and self._node.place_for(session.id)
            hand_over = partial(self._node.hand_over, session) if self._node else None
            if (stream := session.attachment) is not None:
                resumable = self.store.durable
                told = message(Draining, reconnect_in_s=reconnect_in_s(), resumable=resumable, url=url)
                stream.tell(told)
                if resumable:
                    stream.finish(CloseCode.RESTART, "service restart", hand_over)
            elif hand_over is not None:
                hand_over()

    def streams(self) -> int:
        """Return the number of attached streams."""
        return len(self._streams())

    def streams_of(self, owner: str) -> int:
        """Return the number of attached streams of one owner."""
        return sum(s.attachment is not None for s in self._sessions.values() if s.owner == owner)

    def end_streams(self, code: int, reason: str, which: Callable[[AttachedStream], bool] = lambda _: True) -> int:
        """Close all streams, or those that ``which`` chooses, and return their number. The sessions stay."""
        chosen = [stream for stream in self._streams() if which(stream)]
        for stream in chosen:
            stream.end(code, reason)
        return len(chosen)

    def sweep(self) -> None:
        """End sessions that are overdue, cut streams whose clients do not read, and forget what has expired."""
        now = self._clock()
        for session in list(self._sessions.values()):
            if (reason := self._overdue(session)) is not None:
                self.end(session, reason)
            elif session.attachment is not None:
                session.attachment.check(now)
        self._tombstones.sweep()
        self._creations.sweep()

    async def run_sweeper(self) -> None:
        """Sweep for as long as the service runs."""
        while True:
            await asyncio.sleep(SWEEP_EVERY_S)
            self.sweep()

    async def follow_lanes(self) -> None:
        """Restore the sessions of lanes that die, and move those of busy ones, for as long as the service runs."""
        self._restore_lost()
        async for event in self._lanes.events():
            if isinstance(event, LaneCrowded):
                if event.key in self._sessions:
                    self._sessions[event.key].move(event.lane)
                continue
            if isinstance(event, KeysLost):
                self._metrics.lane_restarts.labels(cause=event.cause).inc()
                log.error("lane lost", lane=event.lane, cause=event.cause, sessions=len(event.keys))
            else:
                log.info("lane ready", lane=event.lane, confined=event.confined)
            self._restore_lost()

    def _restore_lost(self) -> None:
        """Restore every session without a lane, including those that gave up waiting for one."""
        for session in self._sessions.values():
            if not session.lane.has_lane:
                session.restore_lane_state()

    def _new(self, owner: str, options: Options, sid: str = "", created_at: datetime | None = None) -> Session:
        """Return a session that has not started yet, under a new id unless ``sid`` is given."""
        if options.idle_timeout_s is None:
            options = replace(options, idle_timeout_s=self._settings.idle_timeout_s)
        sid, created_at = sid or self._new_id(), created_at or datetime.now(UTC)
        self._ordinal += 1
        return Session(
            sid,
            owner,
            options,
            self.store.lane_state(sid, owner),
            on_saveable=self.store.save,
            on_poison=lambda session, detail: self.end(session, EndReason.LOST, detail),
            ordinal=self._ordinal,
            created=self._clock() - max(0.0, (datetime.now(UTC) - created_at).total_seconds()),
            created_at=created_at,
            max_trajectory_bytes=self._settings.max_trajectory_bytes,
            clock=self._clock,
            max_messages_per_s=self._settings.max_messages_per_s,
        )

    def _new_id(self) -> str:
        """Return a new id, which among several nodes begins with the name of this one."""
        random = secrets.token_urlsafe(ID_BYTES)
        return random if self._node is None else f"{self._settings.node}.{random}"

    @asynccontextmanager
    async def _placed(self, session: Session) -> AsyncIterator[None]:
        """Take a place for a session that starts in this block, and add it then. Raises like ``Admission.place``."""
        if self._node is not None:
            session.epoch = await self._node.admit(session.owner, session.id)
        try:
            with self._admission.place(session):
                yield
                self._add(session)
            if self._node is not None:
                await self._node.announce(session.id)
        except ProblemError as refused:
            if refused.code is ProblemCode.AT_CAPACITY and self._node and (other := self._node.another()):
                raise other from refused
            raise

    async def _once(
        self, owner: str, key: str | None, data: bytes | memoryview, rest: str, make: Callable[[], Awaitable[str]]
    ) -> str:
        """Return the id of the session that ``make`` makes, now or when the owner's ``key`` came first, to any node."""
        node = self._node
        if node is None or key is None:
            return await self._creations.once(owner, key, data, rest, make)
        return await self._creations.once(owner, key, data, rest, lambda: node.once(owner, key, data, rest, make))

    def _add(self, session: Session) -> None:
        session.touch()
        self._sessions[session.id] = session
        self._metrics.sessions_created.labels(preset=session.options.preset).inc()

    def _idle_deadline(self, session: Session) -> float:
        if session.attachment is not None:
            return session.touched + self._settings.attached_idle_timeout_s
        assert session.options.idle_timeout_s is not None
        return session.touched + session.options.idle_timeout_s

    def _seconds_left(self, session: Session) -> float:
        """Return the seconds after which the session ends if it is not used again."""
        end = min(self._idle_deadline(session), session.created + self._settings.max_session_s)
        return max(0.0, end - self._clock())

    def _overdue(self, session: Session) -> EndReason | None:
        now = self._clock()
        if now > session.created + self._settings.max_session_s:
            return EndReason.EXPIRED
        return EndReason.IDLE if now > self._idle_deadline(session) and not session.busy else None

    def _within_limits(self, options: Options) -> Options:
        """Return the options of an earlier session with its idle time cut to the limit of this service."""
        assert options.idle_timeout_s is not None
        return replace(options, idle_timeout_s=min(options.idle_timeout_s, self._settings.max_idle_timeout_s))

    def _streams(self) -> list[AttachedStream]:
        return [s.attachment for s in self._sessions.values() if s.attachment is not None]
