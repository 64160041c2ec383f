"""uvicorn's connections, with limits on silence, slowness, floods and the bytes that they hold."""

from __future__ import annotations

import resource

from ..sessions.byte_budget import ByteBudget
from ..settings import Settings
from .base import (
    ABORT_EXTENSION,
    CUT_ABOVE,
    LEAVE_EXTENSION,
    OVER_CONNECTION_LIMIT,
    SHARE,
    WRITE_EXTENSION,
)
from .calls import CallProtocol
from .streams import FrameProtocol

__all__ = [
    "ABORT_EXTENSION",
    "LEAVE_EXTENSION",
    "OVER_CONNECTION_LIMIT",
    "SHARE",
    "WRITE_EXTENSION",
    "allow_files",
    "protocols",
]

SPARE_FILES = 256


def protocols(settings: Settings, budget: ByteBudget) -> tuple[type[CallProtocol], type[FrameProtocol]]:
    """Return the classes of both kinds of connections, bound to ``settings`` and the byte budget, for uvicorn."""
    members = {"settings": settings, "budget": budget}
    return type("Calls", (CallProtocol,), members), type("Frames", (FrameProtocol,), members)


def allow_files(settings: Settings) -> bool:
    """Raise this process' limit of open files to what its connections need. Return whether that suffices."""
    needed = CUT_ABOVE * settings.max_connections + SPARE_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < needed:
        needed = hard
    if soft != resource.RLIM_INFINITY and soft < needed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
    return needed >= settings.max_connections + SPARE_FILES
