"""Read frames from a folder, a video file or a camera; write a video file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ..images.files import SUFFIXES, UNREADABLE_SUFFIXES, BadImageFile, read_image
from ..quiet import quiet
from . import UsageError

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # its warnings would break the one-line errors
if "OPENCV_LOG_LEVEL" not in os.environ:
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

Image = npt.NDArray[np.uint8]

CODECS = {".mp4": "mp4v", ".mkv": "mp4v", ".avi": "MJPG", ".webm": "VP80"}


class MediaError(Exception):
    """A frame cannot be read or a video cannot be written. Printed as one line, with exit code 1."""


@dataclass(frozen=True)
class Source:
    """A source of frames. ``frames`` can be read once, in order; ``length`` is None if it is not known beforehand."""

    frames: Iterator[Image]
    length: int | None
    fps: float
    live: bool = False


def open_source(text: str) -> Source:
    """Open a folder of images (or with an ``img`` folder, as in OTB), a video file, or a camera by its number.

    Raises UsageError if there is no such source. Reading frames raises MediaError.
    """
    path = Path(text)
    if path.is_dir():
        return _folder(path)
    if path.is_file():
        if path.suffix.lower() in SUFFIXES | UNREADABLE_SUFFIXES:
            raise UsageError(f"{text} is one image; name its folder")
        return _video(str(path))
    if text.isascii() and text.isdigit():
        return _video(int(text))
    scheme, is_url, _ = text.partition("://")
    if is_url:
        raise UsageError(
            f"{scheme}:// is not read here, only a folder of images, a video file or a camera's number: "
            "save it first (ffmpeg -i URL -t 60 clip.mp4), or follow it live with mfcmt serve and "
            "docs/examples/track_video.py URL x,y,w,h"
        )
    raise UsageError(f"no folder, video file or camera: {text}")


def _folder(path: Path) -> Source:
    files = _listed(path)
    if not files and (path / "img").is_dir():
        files = _listed(path / "img")
    if not files:
        raise UsageError(f"no images in {path}")

    def frames() -> Iterator[Image]:
        for file in files:
            try:
                yield read_image(file)
            except BadImageFile as bad:
                raise MediaError(str(bad)) from bad

    return Source(frames(), len(files), 30.0)


def _listed(folder: Path) -> list[Path]:
    """Return the images of a folder, in the order of the numbers in their names.

    Raises UsageError if one has a format that cannot be read.
    """
    files = [file for file in folder.iterdir() if not file.name.startswith(".")]
    for file in files:
        if file.suffix.lower() in UNREADABLE_SUFFIXES:
            raise UsageError(f"{file} is of a kind that cannot be read: convert it to JPEG or PNG")

    def key(file: Path) -> list[int | str]:
        return [int(part) if i % 2 else part for i, part in enumerate(re.split(r"([0-9]+)", file.name))]

    return sorted((file for file in files if file.suffix.lower() in SUFFIXES), key=key)


def _video(name: str | int) -> Source:
    with quiet():
        capture = cv2.VideoCapture(name)
    if not capture.isOpened():
        raise UsageError(f"no camera {name}" if isinstance(name, int) else f"not a video: {name}")

    def frames() -> Iterator[Image]:
        try:
            while True:
                ok, image = capture.read()
                if not ok:
                    return
                yield np.asarray(image, np.uint8)
        finally:
            capture.release()

    live = isinstance(name, int)
    length, fps = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), capture.get(cv2.CAP_PROP_FPS)
    return Source(frames(), length if length > 0 and not live else None, fps if 0 < fps < 1000 else 30.0, live)


class VideoFile:
    """A video file to write. It takes its size from the first frame. Raises UsageError for an unknown suffix."""

    def __init__(self, path: str, fps: float) -> None:
        if Path(path).suffix.lower() not in CODECS:
            raise UsageError(f"no codec for {path}; use one of {', '.join(CODECS)}")
        if not Path(path).resolve().parent.is_dir():
            raise UsageError(f"no folder for {path}")
        self._path, self._fps = path, fps
        self._writer: cv2.VideoWriter | None = None

    def write(self, frame: Image) -> None:
        """Append a BGR frame. Raises MediaError."""
        if self._writer is None:
            fourcc = cv2.VideoWriter.fourcc(*CODECS[Path(self._path).suffix.lower()])
            with quiet():
                self._writer = cv2.VideoWriter(self._path, fourcc, self._fps, frame.shape[1::-1])
            if not self._writer.isOpened():
                raise MediaError(f"cannot write {self._path}")
        self._writer.write(frame)

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.release()
