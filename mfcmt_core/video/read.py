"""Read every frame of a video file once, with its number and time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from .errors import MissingFrames, VideoError
from .library import library
from .picture import Converter, Image
from .whole import missing_bytes

SUFFIXES = frozenset(
    {
        *(".3gp", ".asf", ".avi", ".dv", ".flv", ".gif", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg"),
        *(".mts", ".mxf", ".ogv", ".ts", ".vob", ".webm", ".wmv"),
    }
)
"""Suffixes by which a folder's videos are found. A file that is named is opened whatever its suffix is."""

_NO_VIDEO = frozenset({"tty", "image2", "concat", "hls", "sdp", "lavfi"})
"""Formats of FFmpeg that take any text for a picture, or open other files."""

_DAMAGE = {"mjpeg": ("error y=", "error count"), "gif": ("LZW decode failed",)}
"""How messages of a decoder begin that shows a damaged picture and does not mark it."""

_HARMLESS = ("Attempted to read next track",)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame: its number in the source, from 0; its time in seconds; its pixels, ``(H, W, 3)`` uint8, BGR.

    The time is that of the file's own clock, which begins with the file where its format starts anywhere (MPEG). It
    is None where a source has no times: a folder of images.
    """

    index: int
    time_s: float | None
    image: Image


class VideoReader:
    """The frames of a video file, in the order in which they are shown. They can be read once.

    Parameters
    ----------
    path : Path
        A file that FFmpeg decodes. Of several video streams the main one is read, of its pictures what FFmpeg's own
        command makes of them: turned as phones ask, all fields of interlaced ones, 8 bits. Pixels that are not square
        are left as they are stored.

    Attributes
    ----------
    length : int or None
        Number of frames, if the file says it.
    fps : float
        Frames a second on average, 30 if unknown.

    Raises
    ------
    VideoError
        If the file is no video, or of a kind that cannot be decoded. To iterate raises it, too, and at the end
        :class:`MissingFrames` if frames are missing or damaged.
    """

    def __init__(self, path: Path) -> None:
        av = library()
        self.path = path
        self._said = ""
        try:
            self._lacking = missing_bytes(path)
            with av.logging.Capture() as lines:
                self.container = av.open(f"file:{path.absolute()}", metadata_errors="replace")
            self._listen(lines)
        except OSError as failed:  # PyAV's errors are of this kind, too
            if isinstance(failed, av.error.InvalidDataError):
                raise VideoError(f"not a video: {path}, or it was cut off before its index was written") from failed
            raise VideoError(f"cannot read {path}: {failed.strerror or failed}") from failed
        except av.error.FFmpegError as failed:
            raise VideoError(f"not a video: {path}, or it was cut off before its index was written") from failed
        try:
            self._stream = self._choose()
        except VideoError:
            self.container.close()
            raise
        rate = self._stream.average_rate or self._stream.guessed_rate
        self.fps = float(rate) if rate and 0 < rate < 1000 else 30.0
        self._restarts = bool(self.container.format.flags & av.format.Flags.ts_discont.value)
        self.origin_s = self._origin()
        self._stream.codec_context.thread_type = "NONE"  # an error belongs to the packet that was given last
        self._stream.codec_context.thread_count = 1
        self._packets, self._failed, self._damaged = 0, 0, 0
        self._first = 0  # the last frame before the first packet that cannot be decoded
        index = self._stream.index_entries
        self._promised = int(self._stream.frames)
        self.length: int | None = self._promised or None
        if index and self._promised and not self._lacking:  # an index at the end of a file is lost with it
            self._promised = len(index)
            self.length = sum(not entry.is_discard for entry in index)  # an edit list leaves some out

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self.container.close()

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames. Raises VideoError, and MissingFrames at the end."""
        lost: list[int] = []  # times of packets that cannot be decoded, the earliest first
        converter = Converter()
        index, before = -1, float("-inf")
        step = 1 / self.fps
        for picture in self._pictures(lost):
            index += 1
            if picture.pts is not None:
                while lost and lost[0] < picture.pts:
                    heapq.heappop(lost)
                    index += 1
            if not self._failed:
                self._first = index
            self._damaged += picture.is_corrupt
            time_s = index * step if picture.pts is None else self._time(picture.pts)
            if time_s <= before:  # a clock that starts again, as in joined recordings
                time_s = before + step
            before = time_s
            try:
                image = converter.convert(picture)
            except (library().error.FFmpegError, VideoError) as failed:
                raise VideoError(f"{self.path}: frame {index} cannot be converted: {failed}") from failed
            yield Frame(index, time_s, image)
        self._complain(index + 1)

    def _time(self, pts: int) -> float:
        return float(pts * self._stream.time_base) - self.origin_s

    def _choose(self) -> Any:
        """Return the stream to read."""
        if set(self.container.format.name.split(",")) & _NO_VIDEO:
            raise VideoError(f"not a video: {self.path}")
        cover = library().stream.Disposition.attached_pic
        streams = [s for s in self.container.streams.video if not s.disposition & cover]
        best = self.container.streams.best("video")
        stream = best if best in streams else next(iter(streams), None)
        if stream is None:
            raise VideoError(f"{self.path} has no video, only {self._other_kinds()}")
        if stream.codec_context is None:
            raise VideoError(f"{self.path}: this FFmpeg has no decoder for its video")
        return stream

    def _other_kinds(self) -> str:
        kinds = sorted({"a cover picture" if s.type == "video" else str(s.type) for s in self.container.streams})
        return " and ".join(kinds) or "nothing that can be shown"

    def _origin(self) -> float:
        """Return the second of the file's clock that counts as 0."""
        if self._restarts and self.container.start_time:
            return float(Fraction(self.container.start_time, library().time_base))
        return 0.0

    def _pictures(self, lost: list[int]) -> Iterator[Any]:
        """Decode packet by packet, and go on behind one that cannot be decoded."""
        error, capture = library().error.FFmpegError, library().logging.Capture
        packets = self.container.demux(self._stream)
        while True:
            with capture() as lines:
                try:
                    packet = next(packets, None)
                except error:  # the file cannot be read further
                    self._lacking = max(1, self._lacking)
                    packet = None
                packet = packet if packet is not None and packet.size else None
                pictures = self._decode(packet, lost)
            self._listen(lines)
            yield from pictures
            if packet is None:
                return

    def _decode(self, packet: Any, lost: list[int]) -> list[Any]:
        """Return the pictures that a packet completes; None flushes the decoder."""
        if packet is not None:
            self._packets += 1
            if packet.is_corrupt and not self._restarts:  # joined recordings have such packets, which are sound
                self._said = self._said or "a packet is not whole"
        try:
            return list(self._stream.codec_context.decode(packet))
        except EOFError:
            return []
        except library().error.FFmpegError:
            self._failed += 1
            if packet is not None and packet.pts is not None:
                heapq.heappush(lost, packet.pts)
            return []

    def _listen(self, lines: list[tuple[int, str, str]]) -> None:
        """Keep what FFmpeg says of damage that no flag shows: of the container, or of a kind of picture in itself."""
        for _, source, line in lines:
            of_container = source == self.container.format.name and not line.startswith(_HARMLESS)
            if of_container or line.startswith(_DAMAGE.get(source, ())):
                self._said = self._said or line.strip()

    @property
    def fault(self) -> str | None:
        """What is known so far to be missing or damaged, in words that follow the file's name; None for nothing."""
        said = []
        if self._failed:
            said.append(f"has {_frames(self._failed)} that cannot be decoded, the first after frame {self._first}")
        if self._damaged:
            said.append(f"has {_frames(self._damaged)} with damage")
        if self._said and not said:
            said.append(f"is damaged ({self._said})")
        return ", ".join(said) or None

    def _complain(self, count: int) -> None:
        """Raise MissingFrames if frames of the file are missing or damaged. ``count`` frames were read."""
        if not count:
            raise VideoError(f"no frames in {self.path}")
        fault = self.fault
        if self._packets < self._promised or self._lacking:
            of = f" of {self._promised}" if self._packets < self._promised else ""
            more = f", {fault}" if fault and self._failed + self._damaged > 1 else ""
            fault = f"ends after {count}{of} frames, it is cut off{more}"  # the last one is then never whole
        if fault:
            raise MissingFrames(f"{self.path} {fault}")


def _frames(count: int) -> str:
    return f"{count} frame" if count == 1 else f"{count} frames"
