"""The subprotocols of a stream, by name: how a message looks on the socket."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import msgpack

from .documents import Unreadable, from_json, from_msgpack, to_json, to_msgpack
from .enums import ProblemCode
from .problems import ProblemError
from .requests import CONTROLS, Control, FrameMessage, Meta, read
from .values import Echo, check_echo, check_seq

# How JPEG, PNG and WebP begin, as bytes and in base64.
IMAGES = (b"\xff\xd8\xff", b"\x89PN", b"RIF")
IMAGES_IN_BASE64 = ("/9j/", "iVBORw0KGgo", "UklGR", "data:image/")
NO_META = Meta()


@dataclass(frozen=True, slots=True)
class ReceivedFrame:
    """A frame as the service receives it: the encoded image, and what the client said about it.

    With a ``problem`` it is refused, but was a frame and takes its number.
    """

    data: bytes | memoryview
    meta: Meta | FrameMessage = NO_META
    problem: ProblemError | None = None


class Reader(Protocol):
    """Reads a client's messages; it may keep state from one message to the next."""

    def __call__(self, text: str | None, data: bytes | memoryview | None) -> ReceivedFrame | Control | None:
        """Return the message of a text or binary one; None if it only announces the next.

        Raises
        ------
        Unreadable
            The message ends the stream.
        ProblemError
            The message is refused; ``ref`` is the message's own.
        """


class JsonReader:
    """A binary message is a frame; text is a control, or the ``meta`` of the next frame."""

    def __init__(self, max_text_bytes: int) -> None:
        self._max_text = max_text_bytes
        self._meta = NO_META

    def __call__(self, text: str | None, data: bytes | memoryview | None) -> ReceivedFrame | Control | None:
        """See :class:`Reader`."""
        if data is not None:
            meta, self._meta = self._meta, NO_META
            return ReceivedFrame(data, meta)
        assert text is not None
        if text.startswith(IMAGES_IN_BASE64):
            raise Unreadable("an image as base64 text; send the bytes of the JPEG as a binary message")
        if len(text) > self._max_text:
            raise Unreadable(f"text above {self._max_text} characters")
        sent = _map(from_json(text))
        try:
            kind = _kind(sent, Meta.TYPE)
            if kind == Meta.TYPE:
                self._meta = read(Meta, sent)
                return None
            return read(CONTROLS[kind], sent)
        except ProblemError as problem:
            problem.ref = _ref(sent)
            raise


class MsgpackReader:
    """Every message is a map, a frame too."""

    def __init__(self, max_text_bytes: int) -> None:
        pass  # there is no text

    def __call__(self, text: str | None, data: bytes | memoryview | None) -> ReceivedFrame | Control | None:  # noqa: ARG002
        """See :class:`Reader`."""
        if data is None:
            raise Unreadable("text in mfcmt.v1.msgpack; send binary messages, or ask for mfcmt.v1.json")
        if bytes(data[:3]) in IMAGES:
            raise Unreadable('a bare image in mfcmt.v1.msgpack; a frame is {"type": "frame", "frame": bytes}')
        sent = _map(from_msgpack(data))
        if sent.get("type") == FrameMessage.TYPE:
            return _frame(sent)
        try:
            return read(CONTROLS[_kind(sent, FrameMessage.TYPE)], sent)
        except ProblemError as problem:
            problem.ref = _ref(sent)
            raise


@dataclass(frozen=True, slots=True)
class Codec:
    """A subprotocol.

    ``encode`` writes a message, ``decode`` reads one of the service, ``frame`` writes what a client sends for a frame
    and its ``meta``, and ``reader`` makes the service's :class:`Reader` with a bound on texts in bytes.
    """

    name: str
    encode: Callable[[Mapping[str, Any]], str | bytes]
    decode: Callable[[Any], Any]
    frame: Callable[[bytes, Mapping[str, Any]], list[str | bytes]]
    reader: Callable[[int], Reader]


def _json_frame(image: bytes, meta: Mapping[str, Any]) -> list[str | bytes]:
    return [to_json({"type": Meta.TYPE, **meta}), image] if meta else [image]


def _msgpack_frame(image: bytes, meta: Mapping[str, Any]) -> list[str | bytes]:
    return [to_msgpack({"type": FrameMessage.TYPE, "frame": image, **meta})]


JSON = Codec("mfcmt.v1.json", to_json, json.loads, _json_frame, JsonReader)
MSGPACK = Codec("mfcmt.v1.msgpack", to_msgpack, msgpack.unpackb, _msgpack_frame, MsgpackReader)
CODECS: dict[str, Codec] = {codec.name: codec for codec in (JSON, MSGPACK)}
"""The subprotocols; the first one holds for a client that names none."""


def _map(sent: Any) -> dict[str, Any]:
    if not isinstance(sent, dict):
        raise Unreadable("a message is a map")
    return sent


def _kind(sent: dict[str, Any], frame: str) -> str:
    """Return the message's type, a control's or ``frame``. Raises bad-request."""
    kind = sent.get("type")
    if isinstance(kind, str) and (kind == frame or kind in CONTROLS):
        return kind
    detail = f"type is one of {', '.join((frame, *CONTROLS))}"
    if kind == FrameMessage.TYPE:
        detail += "; in mfcmt.v1.json a frame is a binary message, the image's bytes alone"
    raise ProblemError(ProblemCode.BAD_REQUEST, detail)


def _frame(sent: dict[str, Any]) -> ReceivedFrame:
    try:
        message = read(FrameMessage, sent)
        return ReceivedFrame(message.frame, message)
    except ProblemError as problem:
        try:
            return ReceivedFrame(b"", Meta(check_seq(sent.get("seq"))), problem)
        except ProblemError as unnumbered:
            return ReceivedFrame(b"", NO_META, unnumbered)


def _ref(sent: dict[str, Any]) -> Echo | None:
    """Return the ``ref`` of a message that may be wrong in any other way."""
    try:
        return check_echo("ref", sent.get("ref"))
    except ProblemError:
        return None
