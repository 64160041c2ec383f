"""MFCMT: a complementary tracking model with multiple features (Gao et al., 2018)."""

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
