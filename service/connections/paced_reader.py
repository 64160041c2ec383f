"""The input of the WebSocket parser: a bounded number of frames in each turn, and no copies of large messages."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from websockets import frames
from websockets.streams import StreamReader

from ..landing import LARGE_BYTES, Landing
from .whole import MASK_BYTES, apply_mask

# Frames of one connection that are parsed between two turns of the event loop, about 20 µs each.
FRAMES_A_TURN = 32

_parser: Any = frames


def _unless_unmasked(data: Any, mask: bytes) -> Any:
    return data if type(data) is memoryview else apply_mask(data, mask)


# The parser has no other way to take a payload as it is.
_parser.apply_mask = _unless_unmasked


class PacedReader(StreamReader):
    """Stops after a number of frames until the next turn.

    A large payload is unmasked piece by piece, as it arrives, and returned as a memoryview.
    """

    def __init__(self) -> None:
        super().__init__()
        self.behind = False
        self._left = FRAMES_A_TURN
        self._mask: bytes | bytearray = b""
        self._landing: Landing | None = None
        self._between = False

    @property
    def idle(self) -> bool:
        """Whether the parser waits for a frame of which nothing has come."""
        return self._between and not self.buffer

    @property
    def held(self) -> int:
        """The bytes that were read and are not parsed; of a large payload the whole, from its beginning on.

        So of two messages for which there is not room enough, one is read.
        """
        return len(self.buffer) + (0 if self._landing is None else self._landing.size)

    def turn(self, frames: int) -> None:
        """Let the parser read ``frames`` more frames."""
        self._left, self.behind = frames, False

    def clear(self) -> None:
        """Drop what was read, because the connection ends."""
        self.buffer.clear()
        self._landing = None

    def at_eof(self) -> Generator[None, None, bool]:
        """Wait here when the turn's frames are used up; the parser asks before each frame."""
        while self._left <= 0 and self.buffer:
            self.behind = True
            yield
        self._left -= 1
        self._between = True
        ended = yield from super().at_eof()
        self._between = False
        return ended

    def read_exact(self, n: int) -> Generator[None, None, Any]:
        """Return ``n`` bytes. Of a frame, the parser reads the mask right before the payload."""
        if n <= LARGE_BYTES:
            data = yield from super().read_exact(n)
            if n == MASK_BYTES:
                self._mask = data
            return data
        mask, self._landing = self._mask, Landing(n)
        while (landing := self._landing) is not None and (missing := n - landing.filled):
            size = len(self.buffer)
            size = missing if size >= missing else size - size % MASK_BYTES
            if size:
                landing.add(apply_mask(self.buffer[:size], mask))
                del self.buffer[:size]
            elif self.eof:
                raise EOFError(f"stream ends after {landing.filled} bytes, expected {n} bytes")
            else:
                yield
        self._landing = None
        return memoryview(b"") if landing is None else landing.taken()
