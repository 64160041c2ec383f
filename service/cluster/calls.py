"""Small HTTP calls from node to node, over connections that are kept.

httpx takes 1.3 ms of processor time for such a call and httpcore 0.8 ms, which is more than the whole call takes at its
node; this takes 0.05 ms. The parser is httptools', which also serves the calls.
"""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import httptools

CONNECT_S, ANSWER_S = 2.0, 10.0
# Kept for less than uvicorn keeps them (5 s), so that none is closed just when it is used.
KEEP_S = 2.0
MOST_KEPT = 16
READ_BYTES = 65_536

Place = tuple[str, str, int]
Header = tuple[str, str]


class Unreachable(Exception):
    """Nobody accepts a connection there; the call was not sent."""


class NoAnswer(Exception):
    """The call was sent, and the connection broke off or no answer came in time."""


@dataclass(slots=True)
class Answer:
    """An answer as it arrives."""

    status: int = 0
    headers: list[tuple[bytes, bytes]] = field(default_factory=list)
    body: bytes = b""
    whole: bool = False

    def on_header(self, name: bytes, value: bytes) -> None:
        self.headers.append((name.lower(), value))

    def on_body(self, part: bytes) -> None:
        self.body += part

    def on_message_complete(self) -> None:
        self.whole = True


class NodeCalls:
    """Makes calls at other nodes."""

    def __init__(self) -> None:
        self._kept: defaultdict[Place, list[tuple[float, asyncio.StreamReader, asyncio.StreamWriter]]]
        self._kept = defaultdict(list)

    async def call(self, method: str, url: str, headers: Iterable[Header], body: bytes) -> Answer:
        """Make a call. Raises Unreachable, NoAnswer."""
        parts = urlsplit(url)
        place = parts.scheme, parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80)
        target = f"{parts.path or '/'}{'?' if parts.query else ''}{parts.query}"
        lines = [f"{method} {target} HTTP/1.1", f"host: {parts.netloc}", f"content-length: {len(body)}"]
        lines += [f"{name}: {value}" for name, value in headers]
        reader, writer = self._reused(place) or await self._connected(place)
        try:
            writer.write("\r\n".join([*lines, "", ""]).encode("latin-1") + body)
            async with asyncio.timeout(ANSWER_S):
                answer, keeps = await _read(reader)
        except (OSError, TimeoutError, httptools.HttpParserError) as failed:
            writer.close()
            raise NoAnswer(str(failed) or type(failed).__name__) from failed
        except BaseException:
            writer.close()
            raise
        if keeps and len(self._kept[place]) < MOST_KEPT:
            self._kept[place].append((time.monotonic(), reader, writer))
        else:
            writer.close()
        return answer

    def _reused(self, place: Place) -> tuple[asyncio.StreamReader, asyncio.StreamWriter] | None:
        kept = self._kept[place]
        while kept:
            since, reader, writer = kept.pop()
            if time.monotonic() - since < KEEP_S and not reader.at_eof():
                return reader, writer
            writer.close()
        return None

    async def _connected(self, place: Place) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        scheme, host, port = place
        try:
            async with asyncio.timeout(CONNECT_S):
                return await asyncio.open_connection(host, port, ssl=True if scheme == "https" else None)
        except (OSError, TimeoutError) as failed:
            raise Unreachable(str(failed) or type(failed).__name__) from failed

    def close(self) -> None:
        """Close what is kept."""
        for kept in self._kept.values():
            for _, _, writer in kept:
                with suppress(RuntimeError):
                    writer.close()


async def _read(reader: asyncio.StreamReader) -> tuple[Answer, bool]:
    """Return the answer, and whether the connection may be used again. Raises OSError if it breaks off."""
    answer = Answer()
    parser = httptools.HttpResponseParser(answer)
    while not answer.whole:
        data = await reader.read(READ_BYTES)
        if not data:
            raise ConnectionResetError("the connection broke off")
        parser.feed_data(data)
    answer.status = parser.get_status_code()
    return answer, parser.should_keep_alive()
