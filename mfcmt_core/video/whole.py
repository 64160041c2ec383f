"""Tell whether a file ends before its own headers say, for containers without a table of their frames."""

from __future__ import annotations

from pathlib import Path

_EBML, _SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"


def missing_bytes(path: Path) -> int:
    """Return how many bytes an AVI, Matroska or WebM file lacks at its end; 0 for others and where it is not said.

    Raises OSError.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(4096)
    if head[:4] == b"RIFF":
        return max(0, int.from_bytes(head[4:8], "little") + 8 - size)
    if head[:4] == _EBML:
        return max(0, _matroska_end(head) - size)
    return 0


def _matroska_end(head: bytes) -> int:
    """Return where the segment of a Matroska file ends, 0 if its size is not known (a live recording)."""
    length, at = _number(head, 4)
    at += length
    if head[at : at + 4] != _SEGMENT:
        return 0
    length, after = _number(head, at + 4)
    unknown = (1 << 7 * (after - at - 4)) - 1
    return 0 if length == unknown else after + length


def _number(data: bytes, at: int) -> tuple[int, int]:
    """Return an EBML number of variable length and the place after it."""
    first = data[at] if at < len(data) else 0
    count = 9 - first.bit_length() if first else 8
    mask = (1 << 7 * count) - 1
    return int.from_bytes(data[at : at + count], "big") & mask, at + count
