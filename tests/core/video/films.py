"""Video files of every kind that people have, made with FFmpeg's command, and what it makes of their pixels."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import av
import numpy as np

from tests.conftest import require

SIZE, LENGTH = (96, 64), 8
SOURCE = ("-f", "lavfi", "-i", f"testsrc2=s={SIZE[0]}x{SIZE[1]}:r=25:d={LENGTH / 25}")
X264 = ("-c:v", "libx264", "-preset", "ultrafast", "-g", "4")

FILMS: dict[str, tuple[str, ...]] = {
    "h264.mp4": X264,
    "b-frames.mp4": ("-c:v", "libx264", "-preset", "veryfast", "-bf", "3"),
    "full-range-709.mp4": (
        *("-vf", "scale=out_color_matrix=bt709:out_range=full"),
        *("-colorspace", "bt709", "-color_range", "pc", *X264),
    ),
    "interlaced.mp4": ("-vf", "setfield=tff", "-flags", "+ilme+ildct", "-x264opts", "tff=1", *X264),
    "interlaced.mts": ("-vf", "setfield=tff", "-flags", "+ilme+ildct", "-x264opts", "tff=1", *X264),
    "interlaced.mpg": ("-c:v", "mpeg2video", "-flags", "+ilme+ildct"),
    "interlaced.avi": ("-s", "720x576", "-c:v", "dvvideo", "-pix_fmt", "yuv420p"),
    "interlaced.mov": ("-vf", "setfield=tff", "-flags", "+ilme+ildct", "-c:v", "prores_ks"),
    "prores-4444-alpha.mov": ("-c:v", "prores_ks", "-profile:v", "4444", "-pix_fmt", "yuva444p10le"),
    "hevc.mp4": ("-c:v", "libx265", "-preset", "ultrafast", "-x265-params", "log-level=none"),
    "hevc-10-bit.mkv": (
        *("-c:v", "libx265", "-preset", "ultrafast", "-x265-params", "log-level=none"),
        *("-pix_fmt", "yuv420p10le"),
    ),
    "av1.mp4": ("-c:v", "libsvtav1", "-preset", "12"),
    "vp8.webm": ("-c:v", "libvpx", "-deadline", "realtime", "-auto-alt-ref", "1"),
    "vp9.webm": ("-c:v", "libvpx-vp9", "-deadline", "realtime"),
    "vp9-alpha.webm": ("-c:v", "libvpx-vp9", "-deadline", "realtime", "-pix_fmt", "yuva420p"),
    "mjpeg.avi": ("-c:v", "mjpeg", "-pix_fmt", "yuvj422p"),
    "mpeg4.avi": ("-c:v", "mpeg4"),
    "wmv2.wmv": ("-c:v", "wmv2"),
    "flv1.flv": ("-c:v", "flv"),
    "10-bit.mp4": ("-pix_fmt", "yuv420p10le", *X264),
    "422.mp4": ("-pix_fmt", "yuv422p", *X264),
    "444.mp4": ("-pix_fmt", "yuv444p", *X264),
    "gray.mp4": ("-pix_fmt", "gray", *X264),
    "alpha.mov": ("-c:v", "qtrle", "-pix_fmt", "argb"),
    "odd-size.mkv": ("-s", "97x65", "-c:v", "ffv1", "-pix_fmt", "yuv420p"),
    "anamorphic.mp4": ("-vf", "setsar=4/3", *X264),
    "fragmented.mp4": ("-movflags", "frag_keyframe+empty_moov", *X264),
    "no-duration.mkv": ("-f", "matroska", "-live", "1", *X264),
    "no-times.h264": X264,
    "animation.gif": ("-c:v", "gif"),
}
"""What FFmpeg is told for each file."""


def ffmpeg(*words: object) -> bytes:
    """Run ffmpeg and return what it printed."""
    require(shutil.which("ffmpeg"), "no ffmpeg here")
    command = ["ffmpeg", "-v", "error", "-nostdin", "-y", *map(str, words)]
    return subprocess.run(command, capture_output=True, check=True, timeout=120).stdout


def film(path: Path, *words: str) -> Path:
    """Make a file of eight frames with these options, or those of :data:`FILMS` for its name."""
    ffmpeg(*SOURCE, *(words or FILMS[path.name]), path)
    return path


def turned(source: Path, path: Path, matrix: tuple[int, int, int, int]) -> Path:
    """Copy a video and have it shown turned or mirrored: by the numbers 1, 0 or -1 of a display matrix."""
    a, b, c, d = (number << 16 for number in matrix)
    with av.open(str(source)) as old, av.open(str(path), "w") as new:
        stream = new.add_stream_from_template(old.streams.video[0])
        stream.set_display_matrix([a, b, 0, c, d, 0, 0, 0, 1 << 30])
        for packet in old.demux(video=0):
            if packet.size:
                packet.stream = stream
                new.mux(packet)
    return path


def pixels(path: Path) -> np.ndarray:
    """Return what FFmpeg's command decodes of a file, each frame once: uint8, flat, BGR."""
    words = ("-map", "0:v:0", "-fps_mode", "passthrough", "-pix_fmt", "bgr24", "-f", "rawvideo", "-")
    return np.frombuffer(ffmpeg("-i", f"file:{path}", *words), np.uint8)


def times(path: Path) -> list[float]:
    """Return the presentation times that ffprobe reads."""
    words = ("-select_streams", "v:0", "-show_entries", "frame=best_effort_timestamp_time", "-of", "csv=p=0")
    command = ["ffprobe", "-v", "error", *words, f"file:{path}"]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    return [float(line.strip(",")) for line in said.split()]
