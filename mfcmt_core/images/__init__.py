"""Encoded still images: recognize the format, read the header, decode the pixels.

The service, the command and the evaluation all read images with this package, so that they agree on every pixel. This
module is pure Python, so that the service's front can import it. ``decode`` and ``files`` need numpy, OpenCV and
simplejpeg.
"""

from .header import FrameError, FrameInfo, FrameLimits, Kind, inspect, sniff

__all__ = ["FrameError", "FrameInfo", "FrameLimits", "Kind", "inspect", "sniff"]
