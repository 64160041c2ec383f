"""Frames of a camera or a stream as they come, the newest first, with new attempts when it is gone."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing

import cv2
import numpy as np

from ..quiet import quiet
from .errors import VideoError
from .library import library
from .picture import Converter, Image
from .read import Frame

SCHEMES = frozenset({"http", "https", "rtmp", "rtsp", "rtsps", "srt", "udp"})
"""Schemes of the addresses that are read."""

STALL_S = 10.0
"""Seconds without a frame after which a stream counts as gone."""

_LONGEST_PAUSE_S = 15.0


def shown(source: str | int) -> str:
    """Return an address without user name, password and query; ``camera 0`` for a camera."""
    if isinstance(source, int):
        return f"camera {source}"
    return re.sub(r"(?<=://)[^/@]*@", "", source).partition("?")[0]


class LiveVideo:
    """The frames of a camera or a stream. A frame that nobody took before the next one came is left out.

    Iterate once. ``index`` counts the frames that came, ``time_s`` the seconds since the first one.

    Parameters
    ----------
    source : str or int
        An address (HTTP with MJPEG, RTSP, ... : :data:`SCHEMES`), or the number of a camera.
    retry_s : float, optional
        For how long to try again when it is gone.
    for_s : float, optional
        Seconds after which it ends.
    tell : callable, optional
        Gets a line when the source is gone, and one when it is back.

    Raises
    ------
    VideoError
        If the source cannot be opened; to iterate raises it if the source is gone for ``retry_s``.
    """

    def __init__(
        self,
        source: str | int,
        *,
        retry_s: float = 60.0,
        for_s: float | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.name = shown(source)
        self._source, self._retry_s, self._for_s, self._tell = source, retry_s, for_s, tell
        self._ready = threading.Condition()
        self._newest: Frame | None = None
        self._over: str | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._receive, daemon=True)

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames until ``for_s`` has passed."""
        self._thread.start()
        end = None
        try:
            while True:
                with self._ready:
                    while self._newest is None and self._over is None:
                        self._ready.wait(0.1)  # short waits, so that signals are heard
                        if end is not None and time.monotonic() >= end:
                            return
                    frame, self._newest = self._newest, None
                if frame is None:
                    raise VideoError(self._over or self.name)
                if end is None and self._for_s is not None:
                    end = time.monotonic() + self._for_s
                if end is not None and time.monotonic() >= end:
                    return
                yield frame
        finally:
            self._stop.set()
            self._thread.join(1)

    def _receive(self) -> None:
        """Read, and open the source again and again, until it is gone for too long."""
        count, pause, start, last = 0, 1.0, 0.0, time.monotonic()
        gone = False
        while not self._stop.is_set():
            reason = "it ended"
            try:
                with closing(_opened(self._source)) as images:
                    for image in images:
                        last = time.monotonic()
                        start = start if count else last
                        if gone:
                            self._tell(f"{self.name} is back")
                        gone, pause = False, 1.0
                        with self._ready:
                            if self._newest is None or self._newest.index:  # the first one waits to be taken
                                self._newest = Frame(count, last - start, image)
                            self._ready.notify()
                        count += 1
                        if self._stop.is_set():
                            return
            except VideoError as failed:
                reason = str(failed)
            except OSError as failed:
                reason = failed.strerror or str(failed)
            except library().error.ExitError:
                reason = f"no picture for {STALL_S:g} s"
            except library().error.FFmpegError as failed:
                reason = str(failed.strerror)
            if not count:
                self._end(f"cannot open {self.name}: {reason}")
                return
            left = last + self._retry_s - time.monotonic()
            if left <= 0:
                self._end(f"{self.name} is gone: {reason}")
                return
            gone, pause_s = True, min(pause, left)
            self._tell(f"{self.name} is gone ({reason}), trying again in {pause_s:.2g} s")
            self._stop.wait(pause_s)
            pause = min(2 * pause, _LONGEST_PAUSE_S)

    def _end(self, why: str) -> None:
        with self._ready:
            self._over = why
            self._ready.notify()


def _opened(source: str | int) -> Generator[Image, None, None]:
    """Yield images until the source ends. Raises VideoError and OSError."""
    return _camera(source) if isinstance(source, int) else _stream(source)


def _camera(number: int) -> Generator[Image, None, None]:
    with quiet():
        capture = cv2.VideoCapture(number)
    try:
        if not capture.isOpened():
            raise VideoError("there is no such camera")
        while True:
            ok, image = capture.read()
            if not ok:
                raise VideoError("it gives no more pictures")
            yield np.asarray(image, np.uint8)
    finally:
        capture.release()


def _stream(address: str) -> Generator[Image, None, None]:
    options = {"rtsp_transport": "tcp"} if address.startswith("rtsp") else {"fflags": "nobuffer"}
    converter = Converter()
    with library().open(address, timeout=STALL_S, options=options, metadata_errors="replace") as container:
        if not container.streams.video:
            raise VideoError("it has no video")
        if container.duration:
            raise VideoError("it is a file that ends, so save it first: ffmpeg -i ADDRESS -c copy clip.mkv")
        stream = container.streams.video[0]
        stream.codec_context.thread_count = 1
        for packet in container.demux(stream):
            if packet.is_corrupt:  # half a picture
                continue
            try:
                pictures = packet.decode()
            except library().error.InvalidDataError:  # what was lost on the way; the next picture comes
                continue
            for picture in pictures:
                yield converter.convert(picture)
