"""Written videos: codec, times and sound as players want them, and nothing lost if they cannot be completed."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from mfcmt_core.video import VideoError, VideoReader
from mfcmt_core.video.sound import Sound
from mfcmt_core.video.write import CODECS, VideoWriter

from .films import SOURCE, X264, ffmpeg

TIMES = [0.5, 0.54, 0.6, 0.7, 0.74, 1.9]


def picture(at: int) -> np.ndarray:
    """Return an image of odd size with a yellow square that moves."""
    image = np.full((121, 161, 3), 30, np.uint8)
    image[20:60, 10 * at : 10 * at + 40] = (40, 200, 230)
    return image


def probe(path: Path) -> list[dict[str, str]]:
    command = ["ffprobe", "-v", "error", "-show_streams", "-of", "json", f"file:{path}"]
    said = subprocess.run(command, capture_output=True, check=True).stdout
    return json.loads(said)["streams"]


def boxes(path: Path) -> list[str]:
    """Return the names of an MP4's outermost boxes."""
    data, at, names = path.read_bytes(), 0, []
    while at < len(data):
        names.append(data[at + 4 : at + 8].decode())
        at += int.from_bytes(data[at : at + 4], "big")
    return names


@pytest.mark.parametrize("suffix", sorted(CODECS))
def test_pictures_and_times_come_back(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"seen{suffix}"
    writer = VideoWriter(path, 25)
    for at, time_s in enumerate(TIMES):
        writer.write(picture(at), time_s)
        assert not path.exists()
    writer.close()
    assert list(tmp_path.iterdir()) == [path]
    frames = list(VideoReader(path))
    assert len(frames) == len(TIMES)
    if suffix != ".avi":  # its frames have equal distances
        assert [frame.time_s for frame in frames] == pytest.approx(TIMES, abs=1e-3)
    for at, frame in enumerate(frames):
        assert frame.image.shape == (122, 162, 3)
        assert frame.image[40, 10 * at + 20].astype(int) == pytest.approx([40, 200, 230], abs=12)
        assert frame.image[90, 80].astype(int) == pytest.approx([30, 30, 30], abs=6)


def test_an_mp4_is_what_browsers_and_phones_play(tmp_path: Path) -> None:
    path = tmp_path / "clip:1 ä%d.mp4"
    writer = VideoWriter(path, 30000 / 1001)
    for at in range(6):
        writer.write(picture(at), at * 1001 / 30000)
    writer.close()
    (stream,) = probe(path)
    wanted = {"codec_name": "h264", "profile": "High", "pix_fmt": "yuv420p", "color_space": "bt709"}
    assert {key: stream[key] for key in wanted} == wanted
    assert stream["avg_frame_rate"] == "30000/1001"
    assert (stream["start_time"], stream["nb_frames"]) == ("0.000000", "6")
    assert boxes(path) == ["ftyp", "free", "mdat", "moov"]  # one index, no pieces: as QuickTime wants it


@pytest.mark.parametrize(
    ("suffix", "sound", "codec"),
    [
        (".mp4", "aac", "aac"),
        (".mp4", "pcm_s16le", "aac"),
        (".webm", "aac", "opus"),
        (".mkv", "libopus", "opus"),
        (".avi", "aac", "mp3"),
    ],
)
def test_sound_goes_along_as_long_as_the_pictures(suffix: str, sound: str, codec: str, tmp_path: Path) -> None:
    source = tmp_path / "source.mkv"
    ffmpeg(*SOURCE, "-f", "lavfi", "-i", "sine=d=5:r=48000", *X264, "-c:a", sound, source)
    writer = VideoWriter(tmp_path / f"seen{suffix}", 25, Sound(source, 0.0))
    for frame in VideoReader(source):
        assert frame.time_s is not None
        writer.write(frame.image, frame.time_s)
    writer.close()
    video, audio = probe(tmp_path / f"seen{suffix}")
    assert (video["codec_type"], audio["codec_name"]) == ("video", codec)
    heard = ffmpeg("-i", tmp_path / f"seen{suffix}", "-vn", "-f", "s16le", "-ac", "1", "-ar", "8000", "-")
    assert len(heard) / 16000 == pytest.approx(0.32, abs=0.15)


def test_a_source_without_sound_is_no_error(tmp_path: Path) -> None:
    source = tmp_path / "mute.mp4"
    ffmpeg(*SOURCE, *X264, source)
    writer = VideoWriter(tmp_path / "seen.mp4", 25, Sound(source, 0.0))
    writer.write(picture(0), 0)
    writer.close()
    assert len(probe(tmp_path / "seen.mp4")) == 1


def test_what_cannot_be_written_is_one_error_and_leaves_the_old_file(tmp_path: Path) -> None:
    with pytest.raises(VideoError, match=r"no codec for x\.gif; use one of \.mp4"):
        VideoWriter(Path("x.gif"), 25)
    (tmp_path / "folder.mp4").mkdir()
    for path, reason in ((tmp_path / "folder.mp4", "Is a directory"), (tmp_path / "no" / "x.mp4", "No such file")):
        with pytest.raises(VideoError, match=f"cannot write {path}: {reason}"):
            VideoWriter(path, 25).write(picture(0), 0)
    old = tmp_path / "old.mp4"
    old.write_text("old")
    VideoWriter(old, 25).close()  # nothing was tracked
    assert old.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder.mp4", "old.mp4"]
