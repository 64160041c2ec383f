"""States of CVAT's tracks, which CVAT keeps and sends back: sessions or names of sessions, signed for their owner."""

from __future__ import annotations

import asyncio
import struct
from dataclasses import dataclass
from typing import Literal

from ..protocol.documents import Unreadable, from_msgpack
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..snapshot_signer import BadSignature, SnapshotSigner
from .large_json import Document

Kind = Literal[b"V", b"P"]
VALUE: Kind = b"V"
"""The state holds a session of one target, as a snapshot: any replica that has the signing key can go on with it."""
POINTER: Kind = b"P"
"""The state names a target of a session that goes on in this service."""
MAGIC = b"cvat1"
_HEAD = struct.Struct("5sc?")
REFUSED = "a state is not one that this service gave to this caller, or is changed: start the track again"


@dataclass(frozen=True, slots=True)
class State:
    """A state that this service gave.

    ``typed`` says that the shape came as a map with its type, and goes back like that. ``contents`` is a snapshot, or
    the id of a session and that of a target in it, as MessagePack.
    """

    kind: Kind
    typed: bool
    contents: bytes | memoryview

    @property
    def place(self) -> tuple[str, int]:
        """The ids of the session and of the target, of a pointer."""
        session, target = from_msgpack(self.contents)
        return session, target


async def seal(signer: SnapshotSigner, owner: str, state: State) -> bytes:
    """Return ``state`` as bytes that are signed for ``owner``."""
    body = b"".join((_HEAD.pack(MAGIC, state.kind, state.typed), state.contents))
    return await asyncio.to_thread(signer.sign, owner, body)


async def unseal(signer: SnapshotSigner, owner: str, document: Document, text: object) -> State:
    """Return the state in a text of ``document``. Raises bad-request, bad-snapshot."""
    data = await document.decode(text, "a state")
    try:
        body = await asyncio.to_thread(signer.verify, owner, data)
        magic, kind, typed = _HEAD.unpack_from(body)
        state = State(kind, typed, body[_HEAD.size :])
        if magic != MAGIC or kind not in (VALUE, POINTER) or (kind == POINTER and len(state.place) != 2):
            raise BadSignature(REFUSED)
    except (BadSignature, struct.error, Unreadable):
        raise ProblemError(ProblemCode.BAD_SNAPSHOT, REFUSED) from None
    return state
