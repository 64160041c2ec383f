"""A lane that tracks nothing: it gives the same answer at once, so that what is left is the front's work.

It stands alone, without the package of the tests, so that a front of another checkout can run it; see ``cost.py``.
"""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import sys
from collections import Counter
from multiprocessing.context import ForkServerContext
from types import FrameType
from typing import Any

import msgpack

BOX, SCORES = [272.5, 190.25, 64.1, 81.7], [1.0213, 0.9817, 1.114]
TARGET = [0, BOX, "tracking", True, [True] * 3, SCORES, 11.42, True, 1.02, 0.93]
STATE = {"size": [640, 480], "region": [150, 60, 300, 340], "rows": [TARGET], "decode_s": 0.0006, "track_s": 0.0004}
CHECKPOINT = bytes(300_000)


def main(sock: socket.socket, limits: object) -> None:
    """Serve ``sock`` until it ends, in place of :func:`service.lanes.worker.main`."""
    from service.lanes.framing import HELLO, NO_REPLY, decode_call, encode_value
    from service.lanes.wire import LaneWire

    wire = LaneWire(sock)
    with contextlib.suppress(EOFError, ConnectionError):
        wire.send(HELLO, [msgpack.packb({"versions": {"mfcmt": "canned"}, "confined": []})])
        while True:
            call, payload = wire.receive()
            op, _, args, _ = decode_call(payload)
            value: Any = CHECKPOINT if op == "checkpoint" else {"seq": args.get("seq", 0), **STATE, "answers": []}
            if call != NO_REPLY:
                wire.send(call, encode_value(value), 0.001)


def install() -> None:
    """Have this process start canned lanes, and count its calls between two SIGUSR1.

    At the second signal the counts are written to standard error, as one line of JSON.
    """
    from service.lanes import process

    process.worker = sys.modules[__name__]  # type: ignore[assignment]
    ForkServerContext.set_forkserver_preload = lambda *_: None  # type: ignore[method-assign]  # nothing is tracked
    counts: Counter[str] = Counter()

    def count(frame: FrameType, event: str, _: object) -> None:
        counts[event] += 1
        if event == "call":
            code = frame.f_code
            counts[f"{'/'.join(code.co_filename.rsplit('/', 3)[1:])}:{code.co_qualname}"] += 1

    def toggle(*_: object) -> None:
        if sys.getprofile() is None:
            counts.clear()
            sys.setprofile(count)
        else:
            sys.setprofile(None)
            sys.stderr.write(json.dumps({"counted": dict(counts)}) + "\n")
            sys.stderr.flush()

    signal.signal(signal.SIGUSR1, toggle)
