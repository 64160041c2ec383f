"""Encoded still images: told by their magic, measured by their header, decoded.

The service, the command and the evaluation all read images here, so that they agree on what an image is and on its
pixels. This module is pure Python, so that the service's front can import it; ``decode`` and ``files`` need numpy,
OpenCV and simplejpeg.
"""

from .header import FrameError, FrameInfo, FrameLimits, Kind, inspect, sniff

__all__ = ["FrameError", "FrameInfo", "FrameLimits", "Kind", "inspect", "sniff"]
