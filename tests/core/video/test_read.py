"""Every frame of a video file once, with its time and FFmpeg's own pixels, or a word on what is missing."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from mfcmt_core.video import Frame, MissingFrames, VideoError, VideoReader

from .films import FILMS, LENGTH, SIZE, SOURCE, X264, ffmpeg, film, pixels, times, turned


def read(path: Path) -> tuple[np.ndarray, list[float]]:
    """Return flat pixels and times of all frames."""
    with VideoReader(path) as reader:
        frames = list(reader)
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert reader.length in (None, len(frames))
    return np.concatenate([frame.image.ravel() for frame in frames]), [frame.time_s for frame in frames]


@pytest.mark.parametrize("name", FILMS)
def test_pixels_and_times_are_those_of_ffmpeg(name: str, tmp_path: Path) -> None:
    path = film(tmp_path / name)
    got, seconds = read(path)
    assert len(seconds) == LENGTH
    assert np.array_equal(got, pixels(path))
    if not name.endswith((".mts", ".mpg", ".h264")):  # their clocks start anywhere, or are not there
        assert seconds == pytest.approx(times(path), abs=1e-6)
    else:
        assert seconds == pytest.approx(np.arange(LENGTH) / 25, abs=1e-5)


@pytest.mark.parametrize(
    "matrix",
    [(0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0), (-1, 0, 0, 1), (1, 0, 0, -1), (0, 1, 1, 0), (0, -1, -1, 0)],
    ids=str,
)
@pytest.mark.parametrize("kind", ["h264.mp4", "422.mp4"])
def test_a_turned_picture_is_read_upright(kind: str, matrix: tuple[int, int, int, int], tmp_path: Path) -> None:
    path = turned(film(tmp_path / kind), tmp_path / "turned.mp4", matrix)
    with VideoReader(path) as reader:
        first = next(iter(reader)).image
    assert first.shape[:2] == (SIZE if matrix[0] == 0 else SIZE[::-1])
    assert np.array_equal(read(path)[0], pixels(path))


def test_a_turn_by_another_angle_is_refused(tmp_path: Path) -> None:
    path = film(tmp_path / "h264.mp4")
    with av.open(str(path)) as old, av.open(str(tmp_path / "askew.mp4"), "w") as new:
        stream = new.add_stream_from_template(old.streams.video[0])
        stream.set_display_rotation(30)
        for packet in old.demux(video=0):
            if packet.size:
                packet.stream = stream
                new.mux(packet)
    with pytest.raises(VideoError, match="no multiple of 90 degrees"):
        list(VideoReader(tmp_path / "askew.mp4"))


def test_variable_rate_keeps_its_times(tmp_path: Path) -> None:
    path = tmp_path / "vfr.mp4"
    film(path, "-vf", r"setpts=(N+0.5*gt(N\,3)+9*gt(N\,5))/25/TB", "-fps_mode", "vfr", *X264)
    _, seconds = read(path)
    assert len(set(np.diff(seconds).round(4))) > 1
    assert seconds == pytest.approx(times(path), abs=1e-6)


def test_sound_before_and_around_the_pictures_changes_nothing(tmp_path: Path) -> None:
    sine = ("-f", "lavfi", "-i", "sine=d=30")
    path = tmp_path / "late.mkv"
    ffmpeg(*sine, "-itsoffset", "20", *SOURCE, "-map", "0", "-map", "1", *X264, path)
    got, seconds = read(path)
    assert len(seconds) == LENGTH
    assert seconds == pytest.approx(times(path), abs=1e-6)
    assert seconds[0] == pytest.approx(20, abs=0.05)
    assert np.array_equal(got, pixels(path))


def test_frames_that_an_edit_list_leaves_out_are_left_out(tmp_path: Path) -> None:
    whole = film(tmp_path / "whole.mp4", "-c:v", "libx264", "-g", "100")
    path = tmp_path / "edited.mp4"
    ffmpeg("-ss", "0.12", "-i", whole, "-c", "copy", path)
    got, seconds = read(path)
    assert 0 < len(seconds) < LENGTH
    assert np.array_equal(got, pixels(path))


def test_odd_names_are_names(tmp_path: Path) -> None:
    path = film(tmp_path / "h264.mp4")
    for name in ("12:30:00.mp4", "100%03d.mp4", "ä²日本.mp4", "-i.mp4", "a?b#c*.mp4"):
        with VideoReader(path.rename(tmp_path / name)) as reader:
            assert len(list(reader)) == LENGTH
        path = tmp_path / name


@pytest.mark.parametrize("name", ["fast.mp4", "mjpeg.avi", "vp9.webm", "no-duration.mkv", "b-frames.mkv"])
def test_a_file_that_is_cut_off_says_so_after_its_last_frame(name: str, tmp_path: Path) -> None:
    words = {"fast.mp4": ("-movflags", "faststart", *X264), "b-frames.mkv": FILMS["b-frames.mp4"]}
    path = film(tmp_path / name, *words.get(name, FILMS.get(name, ())))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 7 // 10])
    frames: list[Frame] = []
    with VideoReader(path) as reader, pytest.raises(MissingFrames, match=f"{name} (ends after|is damaged)") as missing:
        frames.extend(reader)
    count = len(frames)
    assert 0 < count < LENGTH
    if name in ("fast.mp4", "mjpeg.avi"):
        assert f"ends after {count} of {LENGTH} frames" in str(missing.value)


def test_damaged_packets_are_counted_and_the_others_keep_their_numbers(tmp_path: Path) -> None:
    path = film(tmp_path / "intra.mp4", "-c:v", "libx264", "-preset", "ultrafast", "-g", "1")
    with av.open(str(path)) as container:
        spots = [(p.pos, p.size) for p in container.demux(video=0) if p.size]
    data = bytearray(path.read_bytes())
    start, size = spots[3]
    data[start : start + size] = b"\xff" * size  # no length of a NAL unit fits: it cannot be decoded
    path.write_bytes(data)
    frames = []
    with VideoReader(path) as reader, pytest.raises(MissingFrames, match="1 frame that cannot be decoded") as missing:
        frames.extend(reader)
    assert "the first after frame 2" in str(missing.value)
    assert [frame.index for frame in frames] == [0, 1, 2, 4, 5, 6, 7]
    assert [frame.time_s for frame in frames] == pytest.approx([i / 25 for i in (0, 1, 2, 4, 5, 6, 7)])


def test_damage_that_the_decoder_hides_is_told(tmp_path: Path) -> None:
    path = film(tmp_path / "h264.mp4")
    with av.open(str(path)) as container:
        spots = [(p.pos, p.size) for p in container.demux(video=0) if p.size]
    data = bytearray(path.read_bytes())
    start, size = spots[5]
    data[start + size // 2 : start + size // 2 + 40] = bytes(range(40, 80))
    path.write_bytes(data)
    with VideoReader(path) as reader, pytest.raises(MissingFrames, match="with damage"):
        assert len(list(reader)) == LENGTH


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("text.mp4", b"not a video", "not a video: "),
        ("text.txt", b"hello\nworld\n" * 100, "not a video: "),
        ("empty.mp4", b"", "not a video: "),
        ("list.ffconcat", b"ffconcat version 1.0\nfile h264.mp4\n", "cannot read "),
    ],
)
def test_what_is_no_video_is_refused(name: str, content: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(VideoError, match=says):
        VideoReader(tmp_path / name)


def test_sound_alone_is_refused(tmp_path: Path) -> None:
    ffmpeg("-f", "lavfi", "-i", "sine=d=1", tmp_path / "sound.m4a")
    with pytest.raises(VideoError, match="has no video, only audio"):
        VideoReader(tmp_path / "sound.m4a")
    with pytest.raises(VideoError, match="No such file"):
        VideoReader(tmp_path / "absent.mp4")


def test_without_the_package_the_error_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mfcmt_core.video.library import library

    library.cache_clear()
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    with pytest.raises(VideoError, match=r"pip install 'mfcmt\[video\]'"):
        VideoReader(tmp_path / "a.mp4")
    library.cache_clear()
