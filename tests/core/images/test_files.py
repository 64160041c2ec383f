"""Image files: the same pixels for the command and the evaluation as for the service; what cannot be read is named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core.cli import UsageError, media
from mfcmt_core.images import FrameLimits
from mfcmt_core.images.decode import decode
from mfcmt_core.images.files import SUFFIXES, BadImageFile, list_images, read_image
from mfcmt_core.otb import DataError, Sequence
from tests.core import jpegs
from tests.service.frames import images

PICTURE = jpegs.picture()
CUT = jpegs.plain()[:5000] + b"\xff\xd9"


def save(path, data):
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("kind", ["jpeg", "png", "webp"])
@pytest.mark.parametrize("orientation", [1, 3, 6])
@pytest.mark.parametrize("gray", [False, True])
def test_an_image_file_gives_the_pixels_that_the_service_decodes(kind, orientation, gray, tmp_path):
    """It always has three channels, with and without the EXIF orientation."""
    data = images.oriented(kind, PICTURE[:, :, 0] if gray else PICTURE, orientation)
    image, _ = decode(data, FrameLimits())
    file = save(tmp_path / "picture", data)
    assert np.array_equal(read_image(file), image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    assert np.array_equal(read_image(file), cv2.imread(str(file)))
    assert read_image(file, turned=False).shape == PICTURE.shape


@pytest.mark.parametrize("suffix", [".bmp", ".ppm", ".pgm", ".pbm", ".tif", ".tiff", ".jpe", ".png", ".webp"])
def test_every_supported_format_is_read(suffix, tmp_path):
    assert suffix in SUFFIXES
    source = PICTURE if suffix not in (".pgm", ".pbm") else PICTURE[:, :, 0]
    cv2.imwrite(str(tmp_path / f"1{suffix}"), source)
    assert np.array_equal(read_image(tmp_path / f"1{suffix}"), cv2.imread(str(tmp_path / f"1{suffix}")))


BAD = {
    "cut.jpg": (CUT, "the jpeg image is damaged"),
    "no-image.png": (b"not an image", "not a JPEG, PNG or WebP image"),
    "empty.jpg": (b"", "not a JPEG, PNG or WebP image"),
    "huge.png": (images.png_header(60_000, 60_000), "60000x60000 pixels"),
    "cut.bmp": (images.encode(".bmp", PICTURE)[:60], "the image is damaged"),
    "cut.tif": (images.encode(".tif", PICTURE)[:100], "the image is damaged"),
    "short.png": (images.encode(".png", PICTURE)[:-30], "the PNG is truncated"),
    "gif.jpg": (images.encode(".gif", PICTURE), "not a JPEG, PNG or WebP image"),
}


@pytest.mark.parametrize("name", BAD)
def test_an_unreadable_file_is_named_in_one_line(name, tmp_path, capfd):
    data, reason = BAD[name]
    file = save(tmp_path / name, data)
    with pytest.raises(BadImageFile) as bad:
        read_image(file)
    assert str(bad.value).startswith(f"cannot read {file}: {reason}")
    (tmp_path / "dangling.jpg").symlink_to("nowhere")
    for missing in ("dangling.jpg", "absent.jpg", "."):
        with pytest.raises(BadImageFile, match=r"cannot read .*: (No such file|Is a directory)"):
            read_image(tmp_path / missing)
    assert capfd.readouterr() == ("", "")


def folder_of(tmp_path, *names):
    for name in names:
        save(tmp_path / name, jpegs.plain())
    return tmp_path


def test_a_folder_is_read_in_the_order_of_the_numbers_in_its_names(tmp_path):
    names = ["²1.jpg", "a2.jpg", "a10.jfif", "a100.jpe", "a٣.jpg", "b.JPG"]
    folder = folder_of(tmp_path, *names, "._a2.jpg")
    source = media.open_source(str(folder))
    assert source.length == len(names)
    assert sum(1 for _ in source.frames) == len(names)
    listed = [file.name for file in list_images(folder)]
    assert listed.index("a2.jpg") < listed.index("a10.jfif") < listed.index("a100.jpe")


@pytest.mark.parametrize("name", ["3.heic", "3.HEIF", "3.avif", "3.gif"])
def test_a_folder_with_an_unsupported_image_is_refused(name, tmp_path):
    """If it were skipped, later frames would have wrong numbers."""
    with pytest.raises(UsageError, match=rf"{name} is of a kind that cannot be read"):
        media.open_source(str(folder_of(tmp_path, "1.jpg", "2.jpg", name)))


def test_a_truncated_frame_is_neither_tracked_nor_scored(tmp_path):
    folder = folder_of(tmp_path, "1.jpg", "2.jpg")
    save(folder / "2.jpg", CUT)
    frames = media.open_source(str(folder)).frames
    next(frames)
    with pytest.raises(BadImageFile, match=r"cannot read .*2\.jpg: the jpeg image is damaged"):
        next(frames)
    sequence = Sequence.of("cut", sorted(folder.iterdir()), np.tile([10.0, 10, 40, 30], (2, 1)))
    sequence.read(0)
    with pytest.raises(DataError, match=r"cannot read .*2\.jpg: the jpeg image is damaged"):
        sequence.read(1)


def test_faulty_jpegs_are_tracked_and_scored_as_in_the_service(tmp_path):
    odd = jpegs.before_restarts(jpegs.with_restarts(), b"\0")
    file = save(tmp_path / "1.jpg", odd)
    expected, _ = decode(odd, FrameLimits())
    assert np.array_equal(next(media.open_source(str(tmp_path)).frames).image, expected)
    assert np.array_equal(Sequence.of("odd", [Path(file)], np.ones((1, 4))).read(0), expected)
