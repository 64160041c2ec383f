"""Video files, read and written with PyAV: each frame once, with its time, and a word where one is missing."""

from .errors import MissingFrames, VideoError
from .live import LiveVideo
from .read import SUFFIXES, Frame, VideoReader

__all__ = ["SUFFIXES", "Frame", "LiveVideo", "MissingFrames", "VideoError", "VideoReader"]
