"""The catalogue of problems, where most of the service looks for it; see ``service.protocol.problems``."""

from __future__ import annotations

from .protocol.problems import (
    CATALOGUE,
    MEDIA_TYPE,
    NO_LANE,
    NO_PLACE,
    Kind,
    ProblemError,
    session_gone,
    session_not_found,
)

__all__ = [
    "CATALOGUE",
    "MEDIA_TYPE",
    "NO_LANE",
    "NO_PLACE",
    "Kind",
    "ProblemError",
    "session_gone",
    "session_not_found",
]
