"""Sessions in Redis or Valkey, which several nodes share."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import msgpack
import redis
import structlog

from ..observability.metrics import Metrics
from ..protocol.enums import EndReason
from ..sessions.database import BackgroundWriter, Change, Ended, SavedSession, StateError
from ..sessions.replay_log import Operation
from . import scripts

# One hash tag, so that a cluster of Redis servers has all keys in one slot and the scripts may use them together.
PREFIX = "{mfcmt}:"
# Redis answers within a millisecond; a node must not wait long for one that is away.
TIMEOUT_S = 1.0
FLUSH_S = 10.0
CLAIMS = 3
# How long a session is kept beyond the time in which its node would have ended it.
MARGIN_S = 120.0

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.cluster")


@dataclass(frozen=True, slots=True)
class Node:
    """A node as the others see it: its name, the random name of its process, and its base URL."""

    name: str
    incarnation: str
    url: str

    @property
    def holder(self) -> str:
        """How sessions name the process that has them."""
        return f"{self.name}:{self.incarnation}"


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """What Redis knows of a session: its owner, its epoch, the living node that has it, or how it ended."""

    owner: str
    epoch: int
    node: Node | None = None
    ended: Ended | None = None


class RedisStore(BackgroundWriter):
    """The database of a node. All methods wait for Redis, except those of :class:`BackgroundWriter` that only save."""

    faults = (redis.RedisError, OSError)
    tells_ends = True  # the session holds a place of its owner from its start on

    def __init__(self, url: str, node: Node, metrics: Metrics, *, every_s: float, remember_s: float) -> None:
        super().__init__(metrics, every_s)
        self.node = node
        self.client = connect(url)
        self._remember_ms = int(remember_s * 1e3)
        self._save, self._claim, self._release_claim, self._forget = (
            self.client.register_script(script)
            for script in (scripts.SAVE, scripts.CLAIM, scripts.RELEASE, scripts.FORGET)
        )

    def open(self) -> None:
        """Make sure that Redis answers. Raises StateError."""
        try:
            self.client.ping()
        except (redis.RedisError, OSError) as failed:
            raise StateError(f"MFCMT_STORE: Redis cannot be used ({failed}): see whether it runs there") from failed

    def take_over(self) -> None:
        """Begin to write. Sessions are claimed one by one, when a client asks for them."""
        self._thread.start()

    def load(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """Return nothing: a node has no sessions when it starts."""
        return [], []

    def whereabouts(self, sid: str) -> Whereabouts | None:
        """Return what Redis knows of a session; None if it knows nothing."""
        names = ("owner", "epoch", "holder", "ended", "detail")
        owner, epoch, holder, ended, detail = _texts(self.client.hmget(key("session", sid), names))
        if not owner:
            return None
        if ended:
            return Whereabouts(owner, int(epoch), ended=Ended(owner, int(epoch), EndReason(ended), detail))
        return Whereabouts(owner, int(epoch), self._living(holder))

    def claim(self, sid: str) -> SavedSession | None:
        """Claim a session; None if there is none, or if another node has it and lives."""
        self.flush(FLUSH_S, sid)
        for _ in range(CLAIMS):
            found: Any = self.client.hgetall(key("session", sid))
            if not found or b"ended" in found:
                return None
            living = self._living(found[b"holder"].decode())
            if living is not None and living.holder != self.node.holder:
                return None
            epoch = self._claim(keys=[key("session", sid)], args=[found[b"epoch"], self.node.holder])
            if epoch is not None:
                return self._read(sid, found, int(epoch))
        return None

    def release(self, sid: str, epoch: int) -> None:
        """Give up a session that could not be taken up, or that is saved and to go on elsewhere."""
        self._release_claim(keys=[key("session", sid)], args=[epoch])

    def late(self, epochs: Mapping[str, int]) -> tuple[list[str], list[str]]:
        """Return which of these sessions others have claimed or ended, and which Redis does not know."""
        pipe = self.client.pipeline(transaction=False)
        for sid in epochs:
            pipe.hmget(key("session", sid), "epoch", "ended")
        lost, unknown = [], []
        for (sid, epoch), (seen, ended) in zip(epochs.items(), pipe.execute(), strict=True):
            if seen is None:
                unknown.append(sid)
            elif ended is not None or int(seen) > epoch:
                lost.append(sid)
        return lost, unknown

    def keep(self, seconds: Mapping[str, float]) -> None:
        """Keep each session for so many seconds more."""
        pipe = self.client.pipeline(transaction=False)
        for sid, left_s in seconds.items():
            for kind in ("session", "past"):
                pipe.pexpire(key(kind, sid), int((left_s + MARGIN_S) * 1e3))
        pipe.execute()

    def _living(self, holder: str) -> Node | None:
        """Return the node that holds a session, if its lease has not run out."""
        name, _, incarnation = holder.partition(":")
        if not name:
            return None
        living, url = _texts(self.client.hmget(key("node", name), "incarnation", "url"))
        return Node(name, incarnation, url) if living == incarnation else None

    def _read(self, sid: str, found: Mapping[bytes, bytes], epoch: int) -> SavedSession:
        """Return a claimed session. Raises StateError if it is damaged."""
        front, args, data = found[b"front"], found[b"args"], found[b"data"]
        if _checksum(front, args, data) != int(found[b"checksum"]):
            raise StateError("its saved state is damaged")
        known = msgpack.unpackb(front)
        past = self.client.zrangebyscore(key("past", sid), "-inf", known["seq"])
        entries: deque[tuple[int, bytes]] = deque(tuple(msgpack.unpackb(entry)) for entry in past)
        checkpoint = Operation(found[b"op"].decode(), msgpack.unpackb(args), data)
        with self._changed:
            self._stored.add(sid)
        owner, whole = found[b"owner"].decode(), found[b"whole"] == b"1"
        return SavedSession(sid, owner, known, checkpoint, entries, 0, whole, epoch)

    def _write(self, batch: Mapping[str, Change]) -> list[str]:
        late = []
        for sid, change in batch.items():
            if isinstance(change, SavedSession):
                if not self._put(change):
                    late.append(sid)
            elif change is not None:
                args: Any = [change.epoch, change.owner, change.reason.value, change.detail, self._remember_ms, sid]
                self._forget(keys=_keys(sid, change.owner), args=args)
        return late

    def _put(self, saved: SavedSession) -> bool:
        """Write a session, unless its epoch is late; a whole one may be claimed by others from now on."""
        checkpoint = saved.checkpoint
        front, args, data = msgpack.packb(saved.front), msgpack.packb(checkpoint.args), checkpoint.data
        fields: dict[str, Any] = {
            "owner": saved.owner,
            "front": front,
            "op": checkpoint.op,
            "args": args,
            "data": data,
            "checksum": _checksum(front, args, data),
            "whole": int(saved.whole),
        }
        keep_ms = int((saved.keep_s + MARGIN_S) * 1e3)
        holder = "" if saved.whole else self.node.holder
        words: list[Any] = [saved.epoch, holder, keep_ms, now_ms() + keep_ms, saved.id, saved.first_seq, len(fields)]
        for name, value in fields.items():
            words.extend((name, value))
        for seq, entry in saved.entries:
            words.extend((seq, msgpack.packb((seq, entry))))
        return bool(self._save(keys=_keys(saved.id, saved.owner), args=words))

    def _where(self) -> str:
        options = self.client.connection_pool.connection_kwargs
        return str(options.get("path") or f"{options.get('host')}:{options.get('port')}")

    def _release(self) -> None:
        with suppress(redis.RedisError, OSError):
            self.client.close()


def connect(url: str) -> redis.Redis:
    """Return a client that gives up soon; it connects with its first call. Raises ValueError for another URL."""
    return redis.Redis.from_url(url, socket_timeout=TIMEOUT_S, socket_connect_timeout=TIMEOUT_S, retry=None)


def key(kind: str, name: str) -> str:
    """Return the key of a thing in Redis."""
    return f"{PREFIX}{kind}:{name}"


def now_ms() -> int:
    """Return the milliseconds of the wall clock, which nodes share within seconds."""
    return int(time.time() * 1e3)


def new_epoch() -> int:
    """Return the epoch of a new session."""
    return int(time.time() * 1e6)


def _keys(sid: str, owner: str) -> list[str]:
    return [key("session", sid), key("past", sid), key("owner", owner)]


def _texts(values: Any) -> list[str]:
    return [(value or b"").decode() for value in values]


def _checksum(*parts: bytes | memoryview) -> int:
    total = 0
    for part in parts:
        total = crc32(part, total)
    return total
