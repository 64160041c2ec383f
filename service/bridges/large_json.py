"""JSON with images and states in base64, read and written in short pieces, so that no large text holds up a stream.

To parse or decode megabytes at once would take the event loop for milliseconds, in a thread as well: the interpreter
does nothing else meanwhile.
"""

from __future__ import annotations

import binascii
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any

from .. import turns
from ..landing import LARGE_BYTES, Landing
from ..protocol.documents import Unreadable, from_json
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError

# A text of as many bytes is cut out of the document before that is parsed.
LONG_BYTES = 4096
# Of as many texts, keys included, a document may consist.
MAX_TEXTS = 2048
# Bytes that are encoded in one turn of the event loop; a multiple of 3, and their text of 4.
PIECE_BYTES = 48 * 1024
PIECE_CHARACTERS = PIECE_BYTES // 3 * 4
QUOTE = re.compile(rb'"')
# How a text in the document says that it stands for a long one.
CUT = "\0"


@dataclass(frozen=True, slots=True)
class Document:
    """A parsed document; :meth:`decode` has the long texts, whose places in ``value`` others hold."""

    value: Any
    _cut: list[memoryview]

    async def decode(self, text: Any, what: str) -> bytes | memoryview:
        """Return the bytes that a text of the document is the base64 of. Raises bad-request, which names ``what``."""
        try:
            if type(text) is str and text.startswith(CUT):
                return await _decoded(self._cut[int(text[1:])])
            return await _decoded(memoryview(text.encode("ascii")))
        except (AttributeError, ValueError, IndexError):  # no text, not in ASCII, not base64, a place of none
            raise ProblemError(ProblemCode.BAD_REQUEST, f"{what} is in base64, without line breaks") from None


async def parse(body: bytes | memoryview, most: int) -> Document:
    """Return the document that ``body`` is as JSON; it has ``most`` bytes beside long texts. Raises bad-request."""
    view = memoryview(body)
    parts: list[bytes | memoryview] = []
    cut: list[memoryview] = []
    after = 0
    async for start, end in _texts(view):
        if end - start >= LONG_BYTES:
            parts += view[after:start], rb"\u0000%d" % len(cut)
            cut.append(view[start:end])
            after = end
    parts.append(view[after:])
    if sum(map(len, parts)) > most:
        raise ProblemError(ProblemCode.BAD_REQUEST, f"at most {most} bytes beside what is in base64")
    try:
        return Document(from_json(b"".join(parts)), cut)
    except Unreadable as unreadable:
        raise ProblemError(ProblemCode.BAD_REQUEST, str(unreadable)) from unreadable


async def encode(data: bytes | memoryview) -> AsyncIterator[bytes]:
    """Yield ``data`` in base64, piece by piece."""
    view = memoryview(data)
    for at in range(0, len(view), PIECE_BYTES):
        await turns.give_way()
        yield binascii.b2a_base64(view[at : at + PIECE_BYTES], newline=False)


async def _texts(view: memoryview) -> AsyncIterator[tuple[int, int]]:
    """Yield where each text of the document begins and ends, without its quotes. Raises bad-request."""
    at, count = 0, 0
    while (opening := await _quote(view, at)) is not None:
        start = at = opening + 1
        while (closing := await _quote(view, at)) is not None and _is_escaped(view, start, closing):
            at = closing + 1
        count += 1
        if closing is None or count > MAX_TEXTS:
            raise ProblemError(ProblemCode.BAD_REQUEST, "not a JSON document" if closing is None else "too many items")
        yield start, closing
        at = closing + 1


async def _quote(view: memoryview, at: int) -> int | None:
    """Return where the next quote is."""
    await turns.give_way()
    while at < len(view):
        if (found := QUOTE.search(view, at, at + PIECE_CHARACTERS)) is not None:
            return found.start()
        at += PIECE_CHARACTERS
        await turns.give_way()
    return None


def _is_escaped(view: memoryview, start: int, quote: int) -> bool:
    """Return whether an odd number of backslashes stands before the quote."""
    first = quote
    while first > start and view[first - 1] == 0x5C:
        first -= 1
    return (quote - first) % 2 == 1


async def _decoded(text: memoryview) -> bytes | memoryview:
    """Return what ``text`` is the base64 of. Raises ValueError unless it is the only text that is."""
    size = len(text) // 4 * 3 - bytes(text[-2:]).count(b"=")
    if (
        len(text) % 4
        or binascii.b2a_base64(binascii.a2b_base64(text[-4:], strict_mode=True), newline=False) != text[-4:]
    ):
        raise ValueError("not the shortest text")
    if size < LARGE_BYTES:
        return binascii.a2b_base64(text, strict_mode=True)
    landing = Landing(size)
    for at in range(0, len(text), PIECE_CHARACTERS):
        landing.add(binascii.a2b_base64(text[at : at + PIECE_CHARACTERS], strict_mode=True))
        await turns.give_way()
    return landing.taken()
