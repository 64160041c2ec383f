"""MFCMT: a complementary tracking model with multiple features (Gao et al., 2018).

Names are loaded on first use, so that the command line and the service's front can import the package
without numpy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .config import MFCMTConfig
    from .errors import BadBox, BadConfig, BadImage, BadSnapshot, MFCMTError, NotInitialised, RegionTooSmall
    from .result import Box, Flags, Scores, Status, TrackResult
    from .tracker import MFCMT

__version__ = "0.1.0"

__all__ = [
    "MFCMT",
    "BadBox",
    "BadConfig",
    "BadImage",
    "BadSnapshot",
    "Box",
    "Flags",
    "MFCMTConfig",
    "MFCMTError",
    "NotInitialised",
    "RegionTooSmall",
    "Scores",
    "Status",
    "TrackResult",
    "__version__",
]

_HOME = {"MFCMT": "tracker", "MFCMTConfig": "config"} | dict.fromkeys(
    ("Box", "Flags", "Scores", "Status", "TrackResult"), "result"
)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module("." + _HOME.get(name, "errors"), __name__), name)
    globals()[name] = value
    return value
