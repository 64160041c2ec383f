"""The exchanges that are recorded: each talks to a server and writes what comes back to its tape."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Any

from service.load.own import OwnServer

from .calls import KEY, OTHER, OTHER_KEY, create, frames, refusals, service, sessions, snapshots, targets, trajectory
from .streams import handshakes, keys, regions, rescale, stream_json, stream_msgpack
from .tape import BOX, MSGPACK, Tape, frame

# Settings of the servers that the scenarios talk to.
SERVERS: dict[str, dict[str, Any]] = {
    "open": {"lanes": 1, "max_targets_per_session": 3, "max_messages_per_s": 2000, "signing_keys": "s" * 32},
    "keyed": {
        "lanes": 1,
        "api_keys": f"{KEY},{OTHER_KEY}",
        "max_sessions_per_lane": 4,
        "max_sessions_per_key": 2,
        "max_streams_per_key": 1,
        "max_requests_per_s": 1000,
        "allowed_origins": "https://app.example",
        "max_frame_bytes": 65536,
        "credit_frames": 1,
        "max_frame_pixels": 100_000,
    },
}
Scenario = Callable[[Tape], None]

SCENARIOS: dict[str, tuple[str, Scenario]] = {
    scenario.__name__: (server, scenario)
    for server, scenario in (
        ("open", service),
        ("open", sessions),
        ("open", frames),
        ("open", targets),
        ("open", trajectory),
        ("open", snapshots),
        ("open", refusals),
        ("open", stream_json),
        ("open", stream_msgpack),
        ("open", handshakes),
        ("open", regions),
        ("open", rescale),
        ("keyed", keys),
    )
}


def restart(server: OwnServer) -> str:
    """A stream is told that the server goes away, and resumed when it is back; the transcript."""
    tape = Tape(server)
    sid = create(tape, BOX, OTHER)
    with tape.stream(sid, "mode=lossless") as talk:
        name = talk.hear()["attachment"]
        talk.frame(frame(1), "1")
        talk.hear()
        tape.say("SIGTERM")
        os.kill(server.pid, signal.SIGTERM)
        talk.hear()
        talk.closed()
    _wait_for_end(server)
    server.start()
    with tape.stream(sid, f"mode=lossless&resume={name}") as talk:
        talk.hear()
        talk.frame(frame(2), "2")
        talk.hear()
    tape.call("GET", f"/v1/sessions/{sid}/trajectory?after=0")
    tape.say("SIGKILL")
    os.kill(server.pid, signal.SIGKILL)
    _wait_for_end(server)
    server.start()
    with tape.stream(sid, "mode=lossless", MSGPACK) as talk:
        talk.hear()
        talk.frame(frame(3), "3")
        talk.hear()
        tape.call("GET", f"/v1/sessions/{sid}")
    return tape.text


def _wait_for_end(server: OwnServer) -> None:
    while server.exit_code is None:
        time.sleep(0.02)
    server.stop()


def run(name: str, server: OwnServer) -> str:
    """Play one scenario; its transcript."""
    tape = Tape(server)
    SCENARIOS[name][1](tape)
    tape.end_sessions()
    return tape.text
