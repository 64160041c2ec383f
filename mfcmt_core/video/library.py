"""PyAV, imported when a video is opened: images and cameras do without it."""

from __future__ import annotations

import logging
from functools import cache
from types import ModuleType

from .errors import VideoError


@cache
def library() -> ModuleType:
    """Return the module ``av``; what FFmpeg prints by itself goes nowhere. Raises VideoError if it is not installed."""
    try:
        import av
    except ImportError as absent:
        raise VideoError("video files need the package av: pip install 'mfcmt[video]'") from absent
    logger = logging.getLogger("libav")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    av.logging.set_level(av.logging.ERROR)
    av.logging.set_skip_repeated(False)
    return av
