"""A state directory as it was saved by the code of an earlier version, and what a later one makes of it."""

from __future__ import annotations

import contextlib
import lzma
import os
import shutil
import signal
import sqlite3
import tempfile
import time
from pathlib import Path

from service.load.own import OwnServer

from .calls import create, plain, raw
from .tape import HERE, Tape

STATE = HERE / "state"
# The sessions are as old as the files; no test ends them for that.
SETTINGS = {"lanes": 1, "signing_keys": "g" * 32, "max_session_s": 3.2e8, "idle_timeout_s": 3600}
# Less than the target, so that a tracker's state is small.
SMALL = [73.0, 54.0, 15.0, 12.0]
WAYS = ("stopped", "killed")


def write() -> None:
    """Write both state directories and a snapshot, compressed."""
    STATE.mkdir(exist_ok=True)
    for way in WAYS:
        with tempfile.TemporaryDirectory() as folder:
            with OwnServer(state_dir=folder, checkpoint_every_frames=10_000, **SETTINGS) as server:
                _fill(Tape(server), way)
                if way == "killed":
                    time.sleep(1)  # what is written is written by a thread
                    os.kill(server.pid, signal.SIGKILL)
            _pack(Path(folder), way)


def _fill(tape: Tape, way: str) -> None:
    """Make sessions: one that has tracked, one as it was made, one that ends; and one by default settings.

    Only a service that is stopped has checkpoints on disk: one that is killed has the first frame of each session.
    """
    sid = create(tape, SMALL, label="tracked")
    for index in (1, 2, 3, 4, 3):
        tape.call("POST", f"/v1/sessions/{sid}/frames?ts=t{index}", **raw(index))
    tape.call("PUT", f"/v1/sessions/{sid}/targets/0", **plain({"box": [72.5, 56, 15, 12]}))
    create(tape, SMALL, [110, 70, 14, 12], label="as made", maps=True, on_resize="rescale", idle_timeout_s=1800)
    tape.call("DELETE", f"/v1/sessions/{create(tape, label='ended')}")
    if way == "stopped":
        _write("snapshot", tape.call("GET", f"/v1/sessions/{sid}/snapshot").content)
        sid = create(tape, SMALL, label="default", preset="default")
        for index in (1, 2, 3):
            tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(index))


def _write(name: str, data: bytes) -> None:
    (STATE / f"{name}.xz").write_bytes(lzma.compress(data, preset=9))


def _read(name: str) -> bytes:
    return lzma.decompress((STATE / f"{name}.xz").read_bytes())


def _pack(folder: Path, way: str) -> None:
    file = folder / "sessions.sqlite3"
    with contextlib.closing(sqlite3.connect(file)) as db:
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    _write(way, file.read_bytes())


def take_up(way: str) -> str:
    """Start a server on a copy of the state, and return the transcript of what it knows and how it goes on."""
    folder = Path(tempfile.mkdtemp(prefix="mfcmt-state-"))
    try:
        (folder / "sessions.sqlite3").write_bytes(_read(way))
        with OwnServer(state_dir=folder, **SETTINGS) as server:
            return _go_on(Tape(server))
    finally:
        shutil.rmtree(folder)


def _go_on(tape: Tape) -> str:
    sessions = tape.call("GET", "/v1/sessions").json()["sessions"]
    for session in sessions:
        tape.name(session["id"], "session")
    for session in sessions:
        sid = session["id"]
        tape.call("GET", f"/v1/sessions/{sid}/trajectory")
        tape.call("GET", f"/v1/sessions/{sid}/trajectory?format=csv")
        with tape.stream(sid) as talk:
            talk.hear()
        if session["label"] == "default":
            # What the default settings make of a frame may change; that they go on may not.
            sent = raw(4)
            del sent["note"]
            assert tape.quiet("POST", f"/v1/sessions/{sid}/frames", **sent).status_code == 200
        else:
            tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(4))
            tape.call("POST", f"/v1/sessions/{sid}/targets", **plain({"box": SMALL}))
            tape.call("GET", f"/v1/sessions/{sid}/trajectory")
    tape.say("the snapshot")
    body = {"content": _read("snapshot"), "headers": {"Content-Type": "application/vnd.mfcmt.snapshot"}}
    sid = tape.name(tape.call("POST", "/v1/sessions", **body).json()["id"], "session")
    tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(4))
    return tape.text
