"""Memory for values that arrive in pieces."""

from __future__ import annotations

import pytest

from service.connections.paced_reader import PacedReader
from service.landing import LARGE_BYTES, Landing


def test_pieces_lie_one_behind_the_other_and_no_more_than_announced_is_taken() -> None:
    landing = Landing(10)
    landing.add(b"1234")
    landing.add(memoryview(b"567"))
    assert (landing.filled, bytes(landing.taken())) == (7, b"1234567")
    with pytest.raises(ValueError, match="more than 10 bytes"):
        landing.add(b"89ab")
    assert bytes(landing.taken()) == b"1234567"


@pytest.mark.parametrize("piece", [1, 3, 4, 65_537, 1 << 18])
def test_a_large_payload_is_unmasked_in_whatever_pieces_it_arrives(piece: int) -> None:
    """Of the mask's four bytes, each piece goes on where the one before has ended."""
    mask, size = b"\x01\x02\x03\x04", LARGE_BYTES + 5
    sent = mask * (size // 4) + mask[: size % 4]  # zeros, masked
    reader = PacedReader()
    reader.feed_data(mask)
    with pytest.raises(StopIteration):
        next(reader.read_exact(4))
    reading = reader.read_exact(size)
    first = size - 4 * piece
    reader.feed_data(sent[:first])
    next(reading)
    assert reader.held >= size
    for at in range(first, size - piece, piece):
        reader.feed_data(sent[at : at + piece])
        next(reading)
    reader.feed_data(sent[-piece:])
    with pytest.raises(StopIteration) as end:
        next(reading)
    assert end.value.value == bytes(size)
    assert reader.held == 0
