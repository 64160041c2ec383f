"""Frames of video files, read in order: one file is open at a time in each process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import DataError
from ..video import SUFFIXES, Frame, VideoError, VideoReader

__all__ = ["SUFFIXES", "count_frames", "read_video_frame"]


class _Reader:
    """The file that was read last, its frames and the index of the next one."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._next = 0
        self._video: VideoReader | None = None
        self._frames: Iterator[Frame] = iter(())

    def read(self, path: Path, index: int) -> npt.NDArray[np.uint8]:
        try:
            if path != self._path or index < self._next:
                self._open(path)
            assert self._video is not None
            for frame in self._frames:
                self._next = frame.index + 1
                if self._video.fault:
                    raise VideoError(f"{path} {self._video.fault}")
                if frame.index >= index:
                    break
            else:
                raise VideoError(f"{path}: frame {index} cannot be read: it has {self._next} frames")
            return frame.image
        except VideoError as bad:
            self._close()
            raise DataError(str(bad)) from bad

    def _open(self, path: Path) -> None:
        self._close()
        self._video = VideoReader(path)
        self._path, self._next, self._frames = path, 0, iter(self._video)

    def _close(self) -> None:
        if self._video is not None:
            self._video.close()
        self._path, self._video, self._frames = None, None, iter(())


_reader = _Reader()


def read_video_frame(path: Path, index: int) -> npt.NDArray[np.uint8]:
    """Return frame ``index`` of a video, (H, W, 3) uint8, BGR; cheap if the frame before it was read last.

    Raises DataError if the file has no such frame, and if this frame or one before it is damaged.
    """
    return _reader.read(path, index)


def count_frames(path: Path) -> int | None:
    """Return how many frames a video says it has; None if it does not say. Raises DataError for no video."""
    try:
        with VideoReader(path) as video:
            return video.length
    except VideoError as bad:
        raise DataError(str(bad)) from bad
