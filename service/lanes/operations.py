"""All sessions of a lane by key, and the closed set of operations on them."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import cv2
import numpy as np

from mfcmt_core import BadSnapshot
from mfcmt_core import __version__ as core_version

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from . import contents
from .lane_session import LaneSession
from .limits import LaneLimits


def versions() -> dict[str, str]:
    """Return the versions of the software that results depend on."""
    return {
        "mfcmt": core_version,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "numba": version("numba"),
    }


class LaneOperations:
    """Does what the front asks of a lane."""

    def __init__(self, limits: LaneLimits) -> None:
        self._limits = limits
        self._sessions: dict[str, LaneSession] = {}

    def handle(self, op: str, key: str, args: dict[str, Any], data: bytes) -> Any:
        """Do one operation and return its reply as plain values. Raises ProblemError; then nothing has changed.

        Parameters
        ----------
        op
            ``create``, ``track``, ``control``, ``snapshot``, ``restore``, ``drop``; and to bring sessions back after a
            lane was lost, ``checkpoint`` and ``revive``.
        key
            The session.
        args
            Plain values by name, as each operation needs them.
        data
            The frame, snapshot or checkpoint.
        """
        match op:
            case "track":
                session = self._sessions[key]
                return session.track(args["seq"], data, args.get("region"), args.get("controls", []))
            case "control":
                return self._sessions[key].control(args)
            case "create":
                session = LaneSession(Options(**args["options"]), self._limits)
                state = session.start(data, args["boxes"])
                self._sessions[key] = session
                return state
            case "checkpoint":
                return contents.pack(self._sessions[key].to_dict())
            case "revive":
                return self._revive(key, data)
            case "snapshot":
                # The front may have cut the idle time since the session was made.
                return contents.pack(self._sessions[key].to_dict() | {"options": args["options"]})
            case "restore":
                return self._restore(key, data)
            case "drop":
                self._sessions.pop(key, None)
                return None
            case _:
                raise ValueError(op)

    def _revive(self, key: str, data: bytes) -> dict[str, Any]:
        """Make a session from a checkpoint, which has never left the service."""
        try:
            return self._resume(key, contents.unpack(data)).state()
        except (ValueError, TypeError, KeyError, IndexError) as bad:
            raise ProblemError(ProblemCode.BAD_SNAPSHOT, "the checkpoint cannot be read") from bad

    def _restore(self, key: str, data: bytes) -> dict[str, Any]:
        """Make a session from a snapshot that a client sent in."""
        try:
            found = contents.unpack(data)
            contents.check(found, self._limits.frame, self._limits.max_targets)
            state = self._resume(key, found).state()
        except (BadSnapshot, ValueError) as bad:
            raise ProblemError(ProblemCode.BAD_SNAPSHOT, "its contents do not fit together") from bad
        return state | {"options": found["options"]}

    def _resume(self, key: str, found: dict[str, Any]) -> LaneSession:
        session = self._sessions[key] = LaneSession.from_dict(found, self._limits)
        return session
