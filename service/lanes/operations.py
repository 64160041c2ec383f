"""All sessions of a lane by key, and the closed set of operations on them."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import cv2
import numpy as np

from mfcmt_core import BadSnapshot
from mfcmt_core import __version__ as core_version
from mfcmt_core.images import FrameLimits

from . import contents
from .frame_view import Refused
from .lane_session import LaneSession, Options


def versions() -> dict[str, str]:
    """Versions of what decides over results."""
    return {
        "mfcmt": core_version,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "numba": version("numba"),
    }


class LaneOperations:
    """``config`` is what the front tells its lanes when they start (see ``service.sessions.config``)."""

    def __init__(self, config: dict[str, Any]) -> None:
        self._limits = FrameLimits(**config["frame_limits"])
        self._max_targets: int = config["max_targets"]
        self._region_lag: int = config["region_lag"]
        self._sessions: dict[str, LaneSession] = {}

    def handle(self, op: str, key: str, args: dict[str, Any], data: bytes) -> Any:
        """One operation, of the closed set below. Raises Refused."""
        match op:
            case "track":
                session = self._sessions[key]
                return session.track(args["seq"], data, args.get("region"), args.get("controls", []))
            case "control":
                return self._sessions[key].control(args)
            case "create":
                session = LaneSession(self._options(args["options"]))
                state = session.begin(data, args["boxes"])
                self._sessions[key] = session
                return state
            case "checkpoint":
                return contents.pack(self._sessions[key].to_dict())
            case "revive":
                return self._revive(key, data)
            case "snapshot":
                return contents.pack(self._sessions[key].to_dict() | {"front": args["front"]})
            case "restore":
                return self._restore(key, data)
            case "drop":
                self._sessions.pop(key, None)
                return None
            case _:
                raise ValueError(op)

    def _revive(self, key: str, data: bytes) -> dict[str, Any]:
        try:
            return self._resumed(key, contents.unpack(data)).state()
        except (ValueError, TypeError, KeyError, IndexError) as bad:
            raise Refused("bad-snapshot", "the checkpoint cannot be read") from bad

    def _restore(self, key: str, data: bytes) -> dict[str, Any]:
        try:
            told = contents.unpack(data)
            contents.check(told, self._limits, self._max_targets)
            state = self._resumed(key, told).state()
        except (BadSnapshot, ValueError) as bad:
            raise Refused("bad-snapshot", "its contents do not fit together") from bad
        return state | {"front": told["front"], "options": told["options"]}

    def _resumed(self, key: str, told: dict[str, Any]) -> LaneSession:
        session = self._sessions[key] = LaneSession.from_dict(self._options(told["options"]), told)
        return session

    def _options(self, chosen: dict[str, Any]) -> Options:
        return Options(self._limits, self._max_targets, self._region_lag, **chosen)
