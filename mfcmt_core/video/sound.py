"""Carry the sound of a source over to a video that is written, as it is where the container takes it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .library import library

_COPIED = {
    "mp4": {"aac", "mp3", "ac3", "eac3", "alac"},
    "mov": {"aac", "mp3", "ac3", "eac3", "alac", "pcm_s16le", "pcm_s24le"},
    "matroska": {"aac", "mp3", "ac3", "eac3", "flac", "opus", "vorbis", "pcm_s16le"},
    "webm": {"opus", "vorbis"},
    "avi": {"mp3", "ac3", "pcm_s16le"},
}
"""Codecs that each container takes and players know; other sound is encoded again."""
_ENCODED = {"webm": "libopus", "avi": "libmp3lame"}


class Sound:
    """The main sound of a file. ``open`` adds it to an output; ``write_until`` is called as the pictures go on."""

    def __init__(self, path: Path, origin_s: float) -> None:
        self._source = library().open(f"file:{path.absolute()}", metadata_errors="replace")
        self._stream = self._source.streams.best("audio")
        self._origin_s = origin_s
        self._output: Any = None
        self._target: Any = None
        self._copies = False
        self._waiting: Any = None
        self._packets: Iterator[Any] = iter(())

    def open(self, output: Any) -> None:
        """Add the stream to an output container. A source without sound adds none."""
        stream = self._stream
        if stream is None or stream.codec_context is None:
            return
        kind = output.format.name
        self._copies = stream.codec_context.codec.canonical_name in _COPIED[kind]
        if self._copies:
            self._target = output.add_stream_from_template(stream)
            self._packets = self._copied()
        else:
            rate = 48000 if kind == "webm" else stream.codec_context.sample_rate
            self._target = output.add_stream(_ENCODED.get(kind, "aac"), rate=rate)
            self._target.codec_context.layout = "mono" if stream.codec_context.channels == 1 else "stereo"
            self._packets = self._encoded()
        self._output = output
        self._waiting = next(self._packets, None)

    def write_until(self, time_s: float) -> None:
        """Write what is heard before ``time_s``."""
        while self._waiting is not None:
            packet = self._waiting
            at = packet.pts if packet.dts is None else packet.dts
            if at is not None and float(at * packet.time_base) >= time_s:
                return
            self._output.mux(packet)
            self._waiting = next(self._packets, None)

    def close(self) -> None:
        """Close the source."""
        self._source.close()

    def _copied(self) -> Iterator[Any]:
        for packet in self._demuxed():
            if packet.dts is None:
                continue
            shift = round(self._origin_s / packet.time_base)
            packet.pts, packet.dts = (None if t is None else t - shift for t in (packet.pts, packet.dts))
            packet.stream = self._target
            yield packet

    def _encoded(self) -> Iterator[Any]:
        av = library()
        context = self._target.codec_context
        resampler = av.AudioResampler(context.format, context.layout, context.sample_rate)
        for packet in self._demuxed():
            try:
                frames = packet.decode()
            except av.error.FFmpegError:  # a gap in the sound
                continue
            for frame in frames:
                if frame.pts is not None:
                    frame.pts -= round(self._origin_s / frame.time_base)
                for part in resampler.resample(frame):
                    yield from self._target.encode(part)
        for part in resampler.resample(None):
            yield from self._target.encode(part)
        yield from self._target.encode(None)

    def _demuxed(self) -> Iterator[Any]:
        """Yield packets to the end, or to where the file is cut off."""
        packets = self._source.demux(self._stream)
        while True:
            try:
                packet = next(packets, None)
            except library().error.FFmpegError:
                return
            if packet is None:
                return
            if packet.size:
                yield packet
