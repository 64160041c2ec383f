"""The main loop of a lane's process: one operation after the other, until the socket ends.

Light to import, because the front names :func:`main` as what its children run.
"""

from __future__ import annotations

import contextlib
import socket
import traceback
from time import process_time

import msgpack

from .confine import confine, die_with_parent
from .framing import HELLO, NO_REPLY, decode_call, encode_reply, encode_value
from .interface import Buffers
from .limits import LaneLimits
from .wire import LaneWire


def main(sock: socket.socket, limits: LaneLimits) -> None:
    """Serve ``sock`` until it ends."""
    die_with_parent()  # with the fork server, which dies with the front, even if an operation never ends
    from ..protocol.problems import ProblemError
    from .operations import LaneOperations, versions

    wire = LaneWire(sock)
    operations = LaneOperations(limits)
    hello = {"versions": versions(), "confined": confine()}
    with contextlib.suppress(EOFError, ConnectionError):
        wire.send(HELLO, [msgpack.packb(hello)])
        while True:
            call, payload = wire.receive()
            began = process_time()
            reply: Buffers
            try:
                reply = encode_value(operations.handle(*decode_call(payload)))
            except ProblemError as refused:
                reply = [encode_reply(refused.code, [refused.detail, refused.members])]
            except Exception:
                # The traceback is for the front's log, never for the client.
                reply = [encode_reply("internal", [traceback.format_exc(), {}])]
            if call != NO_REPLY:
                wire.send(call, reply, process_time() - began)
