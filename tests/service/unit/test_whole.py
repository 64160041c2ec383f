"""Messages in one frame, compared with the frames of the library."""

from __future__ import annotations

import pytest
from websockets.frames import Frame, Opcode

from service.connections.whole import BINARY, TEXT, head_of, whole_message

SIZES = (0, 1, 125, 126, 127, 65_535, 65_536, 70_001)
MOST = 1 << 20


def payload_of(size: int) -> bytes:
    return bytes(at * 37 % 251 for at in range(size))


@pytest.mark.parametrize("size", SIZES)
def test_a_message_in_one_frame_is_read(size: int) -> None:
    payload = payload_of(size)
    sent = Frame(Opcode.BINARY, payload).serialize(mask=True)
    assert whole_message(sent, MOST) == payload
    assert whole_message(sent, size) == payload
    assert size == 0 or whole_message(sent, size - 1) is None


@pytest.mark.parametrize("size", SIZES)
def test_a_frame_that_is_cut_off_or_goes_on_is_left_to_the_parser(size: int) -> None:
    sent = Frame(Opcode.BINARY, payload_of(size)).serialize(mask=True)
    for cut in (*range(min(len(sent), 16)), len(sent) - 1):
        assert whole_message(sent[:cut], MOST) is None
    assert whole_message(sent + b"\x82", MOST) is None
    assert whole_message(sent + sent, MOST) is None


@pytest.mark.parametrize(
    "frame",
    [
        Frame(Opcode.TEXT, b"a text"),
        Frame(Opcode.PING, b"a ping"),
        Frame(Opcode.CONT, b"the end of a message"),
        Frame(Opcode.BINARY, b"the beginning of a message", fin=False),
    ],
)
def test_a_frame_that_is_no_binary_message_is_left_to_the_parser(frame: Frame) -> None:
    assert whole_message(frame.serialize(mask=True), MOST) is None


def test_a_frame_that_is_against_the_protocol_is_left_to_the_parser() -> None:
    sent = Frame(Opcode.BINARY, b"a frame").serialize(mask=True)
    for reserved in (0x40, 0x20, 0x10):
        assert whole_message(bytes((sent[0] | reserved,)) + sent[1:], MOST) is None
    assert whole_message(Frame(Opcode.BINARY, bytes(100)).serialize(mask=False), MOST) is None
    assert whole_message(b"\x82\xff" + b"\xff" * 8 + bytes(4), MOST) is None


@pytest.mark.parametrize("size", SIZES)
def test_a_head_is_that_of_the_library(size: int) -> None:
    payload = payload_of(size)
    for opcode, first in ((Opcode.BINARY, BINARY), (Opcode.TEXT, TEXT)):
        assert head_of(payload, first) + payload == Frame(opcode, payload).serialize(mask=False)
