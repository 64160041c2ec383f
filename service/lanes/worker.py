"""The main loop of a lane's process: one operation after the other, until the socket ends.

Light to import, because the front names :func:`main` as what its children run.
"""

from __future__ import annotations

import contextlib
import socket
import traceback
from time import process_time
from typing import Any

import msgpack

from .framing import HELLO, NO_REPLY, BlockingWire, decode_call, encode_reply
from .orphans import die_with_parent


def main(sock: socket.socket, config: dict[str, Any]) -> None:
    """Serve ``sock`` until it ends."""
    die_with_parent()  # the fork server, which dies with the front, even if this computes for ever
    from .confine import confine
    from .frame_view import Refused
    from .operations import LaneOperations, versions

    wire = BlockingWire(sock)
    store = LaneOperations(config)
    hello = {"versions": versions(), "confined": confine()}
    with contextlib.suppress(EOFError, ConnectionError):
        wire.send(HELLO, msgpack.packb(hello))
        while True:
            call, payload = wire.receive()
            began = process_time()
            try:
                reply = encode_reply(None, store.handle(*decode_call(payload)))
            except Refused as refused:
                reply = encode_reply(refused.code, [refused.detail, refused.members])
            except Exception:
                # Where it happened is for the front's log, never for the client.
                reply = encode_reply("internal", [traceback.format_exc(), {}])
            if call != NO_REPLY:
                wire.send(call, reply, process_time() - began)
