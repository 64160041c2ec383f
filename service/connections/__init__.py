"""uvicorn's connections, with an end to what is silent, slow or too much, and a bound to what they hold."""

from __future__ import annotations

import resource

from ..sessions.byte_budget import ByteBudget
from ..settings import Settings
from .base import ABORT_EXTENSION, CUT_ABOVE, LEAVE_EXTENSION, OVER_CONNECTION_LIMIT, SHARE
from .calls import CallProtocol
from .streams import FrameProtocol

__all__ = ["ABORT_EXTENSION", "LEAVE_EXTENSION", "OVER_CONNECTION_LIMIT", "SHARE", "allow_files", "protocols"]

SPARE_FILES = 256


def protocols(settings: Settings, room: ByteBudget) -> tuple[type[CallProtocol], type[FrameProtocol]]:
    """The two, bound to ``settings`` and ``room``: uvicorn makes an instance of each by itself."""
    members = {"settings": settings, "room": room}
    return type("Calls", (CallProtocol,), members), type("Frames", (FrameProtocol,), members)


def allow_files(settings: Settings) -> bool:
    """Raise this process' limit of open files to what its connections may need; whether that is allowed."""
    needed = CUT_ABOVE * settings.max_connections + SPARE_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < needed:
        needed = hard
    if soft != resource.RLIM_INFINITY and soft < needed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
    return needed >= settings.max_connections + SPARE_FILES
