"""Open what `mfcmt track` can read: a folder of images, a video file, a camera."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2

from ..errors import MFCMTError
from ..images.files import SUFFIXES, UNREADABLE_SUFFIXES, BadImageFile, left_out, list_images, read_image
from ..video import Frame, LiveVideo, VideoError, VideoReader
from ..video.live import SCHEMES
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


def open_source(text: str, fps: float | None = None, for_s: float | None = None, retry_s: float = 60.0) -> Source:
    """Open a folder of images (or with an ``img`` folder, as in OTB), a video, a camera by its number, or a stream.

    ``fps`` gives the images of a folder their times; ``for_s`` and ``retry_s`` are for cameras and streams, as in
    :class:`LiveVideo`. Raises UsageError if there is no such source. Reading frames raises MFCMTError.
    """
    path = Path(text)
    scheme, is_url, _ = text.partition("://")
    live = (text.isascii() and text.isdigit()) or is_url
    if for_s is not None and (path.exists() or not live):
        raise UsageError("--for is for cameras and streams; a file ends by itself")
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
    if not live:
        raise UsageError(f"no folder, video file or camera: {text}")
    if is_url and scheme.lower() not in SCHEMES:
        raise UsageError(f"{scheme}:// is not read; addresses of streams begin with {', '.join(sorted(SCHEMES))}")
    video = LiveVideo(text if is_url else int(text), retry_s=retry_s, for_s=for_s, tell=_tell)
    return Source(iter(video), None, 30.0, live=True)


def _tell(line: str) -> None:
    print(f"mfcmt track: {line}", file=sys.stderr, flush=True)


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
        _tell(f"left out as no images: {names}{more}")

    def frames() -> Iterator[Frame]:
        for index, file in enumerate(files):
            yield Frame(index, index / fps if fps else None, read_image(file))

    return Source(frames(), len(files), fps or 30.0, path=place, images=tuple(file.name for file in files))
