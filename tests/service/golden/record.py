"""Write the transcripts anew: ``python -m tests.service.golden.record``.

A transcript is written only when the protocol is meant to answer otherwise than before; its diff says how.
``--state`` also writes the saved state: only when the state of another version is to be kept instead.
"""

from __future__ import annotations

import sys
import tempfile
from contextlib import ExitStack

from service.load.own import OwnServer

from . import saved
from .scenarios import SCENARIOS, SERVERS, restart, run
from .tape import HERE

TRANSCRIPTS = HERE / "transcripts"
RESTART = {"lanes": 1, "checkpoint_every_frames": 10_000}


def main() -> None:
    """Record every scenario."""
    TRANSCRIPTS.mkdir(exist_ok=True)
    with ExitStack() as stack:
        servers = {name: stack.enter_context(OwnServer(**settings)) for name, settings in SERVERS.items()}
        for name, (server, _) in SCENARIOS.items():
            (TRANSCRIPTS / f"{name}.txt").write_text(run(name, servers[server]), encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder, OwnServer(state_dir=folder, **RESTART) as server:
        (TRANSCRIPTS / "restart.txt").write_text(restart(server), encoding="utf-8")
    if "--state" in sys.argv:
        saved.write()
    for way in saved.WAYS:
        (saved.STATE / f"{way}.txt").write_text(saved.take_up(way), encoding="utf-8")


if __name__ == "__main__":
    main()
