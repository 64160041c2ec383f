"""Frames of video files, read in order: one file is open at a time in each process."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ..quiet import quiet
from .errors import DataError

SUFFIXES = frozenset({".mp4", ".mkv", ".avi", ".webm", ".mov"})


class _Reader:
    """The file that was read last and the index of its next frame."""

    def __init__(self) -> None:
        self.path: Path | None = None
        self.next = 0
        self.capture = cv2.VideoCapture()

    def read(self, path: Path, index: int) -> npt.NDArray[np.uint8]:
        if path != self.path or index < self.next:
            with quiet():
                self.capture.open(str(path))
            self.path, self.next = path, 0
        while self.next < index and self.capture.grab():
            self.next += 1
        ok, image = self.capture.read() if self.next == index else (False, None)
        if not ok:
            self.path = None
            raise DataError(f"{path}: frame {index} cannot be read")
        self.next += 1
        return np.asarray(image, np.uint8)


_reader = _Reader()


def read_video_frame(path: Path, index: int) -> npt.NDArray[np.uint8]:
    """Frame ``index`` of a video, (H, W, 3) uint8, BGR; cheap where the frame before it was read last.

    Raises DataError where the file has no such frame.
    """
    return _reader.read(path, index)
