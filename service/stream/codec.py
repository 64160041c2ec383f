"""The two subprotocols: how a message looks on the socket."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any, Protocol

from ..problems import ProblemError
from ..schemas.packed import Unreadable, from_json, from_msgpack, to_json, to_msgpack
from . import messages
from .messages import CONTROLS, Control, FrameMessage, Meta

IMAGES = (b"\xff\xd8\xff", b"\x89PN", b"RIF")
"""How JPEG, PNG and WebP begin."""
IMAGES_IN_BASE64 = ("/9j/", "iVBORw0KGgo", "UklGR", "data:image/")
"""How they begin in base64."""

Event = MutableMapping[str, Any]


class Codec(Protocol):
    """A subprotocol; what it reads may keep state from one message to the next."""

    name: str

    def read(self, event: Event) -> FrameMessage | Control | None:
        """The message of an ASGI ``websocket.receive`` event; None if it only prepares the next.

        Raises Unreadable for a message that ends the stream, ProblemError for one that is refused.
        """

    def write(self, message: dict[str, Any]) -> Event:
        """An ASGI ``websocket.send`` event."""


class Refusal(ProblemError):
    """A message is refused; ``ref`` is the message's own."""

    def __init__(self, problem: ProblemError, ref: messages.Echo) -> None:
        super().__init__(problem.code, problem.detail, **problem.members)
        self.ref = ref


class JsonCodec:
    """A binary message is a frame; text is a control, or the ``meta`` of the next frame."""

    name = "mfcmt.v1.json"
    _NOTHING = Meta()

    def __init__(self, max_text_bytes: int) -> None:
        self._max_text = max_text_bytes
        self._meta = self._NOTHING

    def read(self, event: Event) -> FrameMessage | Control | None:
        """See :class:`Codec`."""
        data = event.get("bytes")
        if data is not None:
            meta, self._meta = self._meta, self._NOTHING
            return FrameMessage(data, meta)
        text = event["text"]
        if text.startswith(IMAGES_IN_BASE64):
            raise Unreadable("an image as base64 text; send the bytes of the JPEG as a binary message")
        if len(text) > self._max_text:
            raise Unreadable(f"text above {self._max_text} characters")
        message = from_json(text)
        if not isinstance(message, dict):
            raise Unreadable("a message is a map")
        try:
            kind = messages.kind_of(message, ("meta", *CONTROLS))
            if kind == "meta":
                self._meta = messages.meta(message)
                return None
            return messages.control(kind, message)
        except ProblemError as problem:
            raise Refusal(problem, messages.echoed_ref(message)) from problem

    def write(self, message: dict[str, Any]) -> Event:
        """See :class:`Codec`."""
        return {"type": "websocket.send", "text": to_json(message)}


class MsgpackCodec:
    """Every message is a map."""

    name = "mfcmt.v1.msgpack"

    def read(self, event: Event) -> FrameMessage | Control | None:
        """See :class:`Codec`."""
        data = event.get("bytes")
        if data is None:
            raise Unreadable("text in mfcmt.v1.msgpack; send binary messages, or ask for mfcmt.v1.json")
        if data[:3] in IMAGES:
            raise Unreadable('a bare image in mfcmt.v1.msgpack; a frame is {"type": "frame", "frame": bytes}')
        message = from_msgpack(data)
        if not isinstance(message, dict):
            raise Unreadable("a message is a map")
        try:
            kind = messages.kind_of(message, ("frame", *CONTROLS))
            return messages.frame(message) if kind == "frame" else messages.control(kind, message)
        except ProblemError as problem:
            raise Refusal(problem, messages.echoed_ref(message)) from problem

    def write(self, message: dict[str, Any]) -> Event:
        """See :class:`Codec`."""
        return {"type": "websocket.send", "bytes": to_msgpack(message)}
