"""Open what `mfcmt track` can read: a folder of images, a video file, a camera."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..errors import MFCMTError
from ..images.files import SUFFIXES, UNREADABLE_SUFFIXES, BadImageFile, left_out, list_images, read_image
from ..quiet import quiet
from ..video import Frame, VideoError, VideoReader
from . import UsageError

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # its warnings would break the one-line errors
if "OPENCV_LOG_LEVEL" not in os.environ:
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


class MediaError(MFCMTError):
    """A frame cannot be read or a result cannot be written. Printed as one line, with exit code 1."""


@dataclass(frozen=True)
class Source:
    """A source of frames.

    ``frames`` can be read once, in order; ``length`` is None if it is not known beforehand. ``path`` is the file or
    the folder, and None for a camera; ``images`` are the names of a
    folder's images, ``origin_s`` the second of a video's own clock that is its 0.
    """

    frames: Iterator[Frame]
    length: int | None
    fps: float
    live: bool = False
    path: Path | None = None
    images: tuple[str, ...] = ()
    origin_s: float = 0.0


def open_source(text: str, fps: float | None = None) -> Source:
    """Open a folder of images (or with an ``img`` folder, as in OTB), a video file, or a camera by its number.

    ``fps`` gives the images of a folder their times. Raises UsageError if there is no such source. Reading frames
    raises MFCMTError.
    """
    path = Path(text)
    if path.is_dir():
        return _folder(path, fps)
    if path.is_file():
        if path.suffix.lower() in SUFFIXES | UNREADABLE_SUFFIXES - {".gif"}:
            raise UsageError(f"{text} is one image; name its folder")
        try:
            reader = VideoReader(path)
        except VideoError as bad:
            raise UsageError(str(bad)) from bad
        return Source(iter(reader), reader.length, reader.fps, path=path, origin_s=reader.origin_s)
    if text.isascii() and text.isdigit():
        return _camera(int(text))
    scheme, is_url, _ = text.partition("://")
    if is_url:
        raise UsageError(
            f"{scheme}:// is not read here, only a folder of images, a video file or a camera's number: "
            "save it first (ffmpeg -i URL -t 60 clip.mp4), or follow it live with mfcmt serve and "
            "docs/examples/track_video.py URL x,y,w,h"
        )
    raise UsageError(f"no folder, video file or camera: {text}")


def _folder(path: Path, fps: float | None) -> Source:
    place = path if list_images(path) or not (path / "img").is_dir() else path / "img"
    try:
        others = left_out(place)
    except BadImageFile as bad:
        raise UsageError(str(bad)) from bad
    files = list_images(place)
    if not files:
        raise UsageError(f"no images in {path}")
    if others:
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        names = ", ".join(file.name for file in others[:3])
        print(f"mfcmt track: left out as no images: {names}{more}", file=sys.stderr)

    def frames() -> Iterator[Frame]:
        for index, file in enumerate(files):
            yield Frame(index, index / fps if fps else None, read_image(file))

    return Source(frames(), len(files), fps or 30.0, path=place, images=tuple(file.name for file in files))


def _camera(number: int) -> Source:
    with quiet():
        capture = cv2.VideoCapture(number)
    if not capture.isOpened():
        raise UsageError(f"no camera {number}")

    def frames() -> Iterator[Frame]:
        try:
            index, start = 0, None
            while True:
                ok, image = capture.read()
                if not ok:
                    return
                now = cv2.getTickCount() / cv2.getTickFrequency()
                start = now if start is None else start
                yield Frame(index, now - start, np.asarray(image, np.uint8))
                index += 1
        finally:
            capture.release()

    fps = capture.get(cv2.CAP_PROP_FPS)
    return Source(frames(), None, fps if 0 < fps < 1000 else 30.0, live=True)
