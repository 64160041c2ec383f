"""Write a video file that browsers, phones and desktop players show, each frame at its own time."""

from __future__ import annotations

import os
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..files import partial_name
from .errors import VideoError
from .library import library
from .picture import Image
from .sound import Sound

CODECS = {
    **dict.fromkeys((".mp4", ".m4v", ".mov", ".mkv"), "libx264"),
    ".webm": "libvpx-vp9",
    ".avi": "mpeg4",
}
"""The encoder by the file's suffix."""

_TICKS = 90000
"""Ticks of a second: most rates of frames are whole numbers of them."""

_SETTINGS = {
    "libx264": {"preset": "veryfast", "crf": "20", "bf": "0"},
    "libvpx-vp9": {"deadline": "realtime", "cpu-used": "8", "crf": "30", "b": "0"},
    "mpeg4": {"qscale": "3"},
}
_BT709, _LIMITED = 1, 1  # FFmpeg's numbers


def check_target(path: Path) -> None:
    """Raise VideoError if no video can be written under this name."""
    if path.suffix.lower() not in CODECS:
        raise VideoError(f"no codec for {path}; use one of {', '.join(CODECS)}")
    library()


class VideoWriter:
    """A video file, written under another name beside it, and moved to ``path`` when it is whole.

    It takes its size from the first frame: one more pixel where a side is odd; later frames are brought to it.

    Parameters
    ----------
    path : Path
        Where it goes. Its suffix, one of :data:`CODECS`, decides on container and codec.
    fps : float
        Frames a second; it tells the codec the usual distance of frames, whose times are kept as they are given.
    sound : Sound, optional
        What is heard; it is closed with the file.

    Raises
    ------
    VideoError
        If the file cannot be written.
    """

    def __init__(self, path: Path, fps: float, sound: Sound | None = None) -> None:
        check_target(path)
        self._path = path
        self._partial = partial_name(path)
        self._rate = Fraction(fps).limit_denominator(1001) if fps > 0 else Fraction(30)
        self._avi = path.suffix.lower() == ".avi"  # which has frames at equal distances
        self._base = 1 / self._rate if self._avi else Fraction(1, _TICKS)
        self._container: Any = None
        self._stream: Any = None
        self._size = (0, 0)
        self._last = -1
        self._count = 0
        self._sound = sound

    def write(self, image: Image, time_s: float) -> None:
        """Append a BGR image, (H, W, 3) uint8, shown from ``time_s`` on."""
        av = library()
        try:
            if self._container is None:
                self._open(image.shape[1], image.shape[0])
            frame = av.VideoFrame.from_ndarray(self._fitted(image), format="bgr24")
            frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG", threads=1)
            frame.colorspace, frame.color_range = _BT709, _LIMITED
            self._last = max(self._last + 1, round(time_s / self._base))
            frame.pts, frame.time_base = self._last, self._base
            frame.duration = round(1 / self._rate / self._base)
            for packet in self._stream.encode(frame):
                self._container.mux(packet)
            if self._sound:
                self._sound.write_until(float(self._last * self._base))
            self._count += 1
        except (OSError, av.error.FFmpegError) as failed:
            raise self._broken(failed) from failed

    def close(self) -> None:
        """Complete the file and move it to its name; nothing is left of one without frames."""
        if self._container is None:
            return
        av = library()
        container, self._container = self._container, None
        try:
            for packet in self._stream.encode(None):
                container.mux(packet)
            if self._sound:
                self._sound.write_until(float((self._last + 1) * self._base) + 1 / float(self._rate))
            container.close()
            os.replace(self._partial, self._path)
        except (OSError, av.error.FFmpegError) as failed:
            raise self._broken(failed) from failed

    def _open(self, width: int, height: int) -> None:
        av = library()
        suffix = self._path.suffix.lower()
        # In pieces that play if the end is never written; when it is, they become one, with an index.
        options = {"movflags": "+hybrid_fragmented+delay_moov"} if suffix in (".mp4", ".m4v", ".mov") else {}
        kind = {".m4v": "mp4", ".mkv": "matroska"}.get(suffix, suffix[1:])
        self._size = (width + width % 2, height + height % 2)
        if self._path.is_dir():
            raise IsADirectoryError(21, os.strerror(21))
        self._partial.touch()  # FFmpeg opens it when it has something to write
        self._container = av.open(f"file:{self._partial.absolute()}", "w", format=kind, options=options)
        codec = CODECS[suffix]
        stream = self._container.add_stream(codec, rate=self._rate, options=dict(_SETTINGS[codec]))
        stream.width, stream.height = self._size
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.time_base = self._base
        context.gop_size = max(1, round(2 * self._rate))  # what is lost if the disk is full
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = _LIMITED
        context.thread_count = 1
        self._stream = stream
        if self._sound:
            self._sound.open(self._container)

    def _fitted(self, image: Image) -> Image:
        width, height = self._size
        down, across = height - image.shape[0], width - image.shape[1]
        if (down, across) == (0, 0):
            return np.ascontiguousarray(image)
        if 0 <= down <= 1 and 0 <= across <= 1:
            return np.asarray(cv2.copyMakeBorder(image, 0, down, 0, across, cv2.BORDER_REPLICATE), np.uint8)
        return np.asarray(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA), np.uint8)

    def _broken(self, failed: Any) -> VideoError:
        """Return the error to raise; what was written is kept under its other name, if there is something."""
        container, self._container = self._container, None
        try:
            if container is not None:
                container.close()
        except (OSError, library().error.FFmpegError):
            pass
        reason = failed.strerror or str(failed)
        kept = self._partial.exists() and self._partial.stat().st_size > 0 and self._count
        if not kept:
            self._partial.unlink(missing_ok=True)
            return VideoError(f"cannot write {self._path}: {reason}")
        return VideoError(f"cannot write {self._path}: {reason}; what there is of it is in {self._partial}")
