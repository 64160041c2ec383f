"""The lane's end of its socket to the front."""

from __future__ import annotations

import select
import socket
from collections import deque

from ..landing import LARGE_BYTES, Landing
from .framing import HEAD, PART, PART_BYTES, SIZE, TOOK, begin_parts
from .interface import Buffers


class LaneWire:
    """Receives one call at a time, and sends replies; a large one in parts, which no other call or reply waits for."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(True)
        self._sock = sock
        self._poll = select.poll()
        self._poll.register(sock, select.POLLIN | select.POLLOUT)
        self._head = bytearray(HEAD.size)
        self._buffer = bytearray(1 << 18)
        self._length: int | None = None  # of the message that is being received, once its head is known
        self._got = self._call = 0
        self._parts: dict[int, Landing] = {}
        self._unsent: deque[memoryview] = deque()  # messages that were begun or are small, in their order
        self._large: deque[tuple[int, memoryview]] = deque()  # the numbers and rests of large replies

    def receive(self) -> tuple[int, memoryview]:
        """Return ``call, payload``; the payload is valid until the next call. Raises EOFError at the end."""
        self._flush()
        while (payload := self._received()) is None:
            self._poll.poll()
            self._flush()
        return self._call, payload

    def send(self, call: int, payload: Buffers, took: float = 0.0) -> None:
        """Send one reply, now or, as far as the socket is full, while the next call is awaited."""
        *heads, last = (TOOK.pack(took), *payload)
        rest = memoryview(last)
        if len(rest) > LARGE_BYTES:
            size = SIZE.pack(sum(map(len, payload)))
            self._put(call | PART, (heads[0], size, *heads[1:], rest[:PART_BYTES]))
            self._large.append((call, rest[PART_BYTES:]))
        else:
            self._put(call, (*heads, rest))
        self._flush()

    def _received(self) -> memoryview | None:
        """Return the payload of the next call if all of it has come."""
        while True:
            if self._length is None:
                if not self._fill(memoryview(self._head)):
                    return None
                self._length, self._call = HEAD.unpack(self._head)
                if self._length > len(self._buffer):
                    self._buffer = bytearray(self._length)
            if not self._fill(memoryview(self._buffer)[: self._length]):
                return None
            payload = memoryview(self._buffer)[: self._length]
            self._length = None
            if not self._call & PART:
                return self._joined(payload)
            number = self._call ^ PART
            if not payload:
                self._parts.pop(number, None)
            elif number in self._parts:
                self._parts[number].add(payload)
            else:
                self._parts[number] = begin_parts(payload)

    def _joined(self, end: memoryview) -> memoryview:
        """Return ``end`` with the parts before it, which is the whole payload."""
        if (landing := self._parts.pop(self._call, None)) is None:
            return end
        landing.add(end)
        return landing.taken()

    def _fill(self, view: memoryview) -> bool:
        """Receive what belongs into ``view``. Return False if some is missing; the next call goes on there.

        This waits for the rest if there is nothing to send meanwhile.
        """
        flags = socket.MSG_DONTWAIT if self._unsent or self._large else socket.MSG_WAITALL
        while self._got < len(view):
            try:
                got = self._sock.recv_into(view[self._got :], 0, flags)
            except BlockingIOError:
                return False
            if got == 0:
                raise EOFError
            self._got += got
        self._got = 0
        return True

    def _put(self, call: int, payload: Buffers) -> None:
        size = sum(map(len, payload))
        self._unsent.extend(memoryview(data) for data in (HEAD.pack(size, call), *payload))

    def _flush(self) -> None:
        """Send as much as the socket takes: first what was begun or is small, then parts of large replies."""
        while True:
            if not self._unsent and not self._take_part():
                return
            try:
                sent = self._sock.sendmsg(self._unsent, (), socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            while self._unsent and sent >= len(self._unsent[0]):
                sent -= len(self._unsent.popleft())
            if sent:
                self._unsent[0] = self._unsent[0][sent:]

    def _take_part(self) -> bool:
        """Begin the next part of a large reply, one after the other. Return False if there is none."""
        if not self._large:
            return False
        call, rest = self._large.popleft()
        if len(rest) > PART_BYTES:
            self._large.append((call, rest[PART_BYTES:]))
            self._put(call | PART, (rest[:PART_BYTES],))
        else:
            self._put(call, (rest,))
        return True
