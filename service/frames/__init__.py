"""One encoded still image: told by its magic, measured by its header, decoded in a lane.

The header half is pure Python, so that the front can import it; ``service.frames.decode`` needs numpy,
OpenCV and simplejpeg.
"""

from .header import FrameError, FrameInfo, FrameLimits, Kind, inspect, sniff

__all__ = ["FrameError", "FrameInfo", "FrameLimits", "Kind", "inspect", "sniff"]
