"""What can go wrong with a video."""

from __future__ import annotations

from ..errors import MFCMTError


class VideoError(MFCMTError):
    """A video cannot be read or written. The message names the file and the reason."""


class MissingFrames(VideoError):
    """Frames of the file are missing or damaged. It is raised after the last frame that can be read."""
