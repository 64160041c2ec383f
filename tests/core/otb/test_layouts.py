"""GOT-10k, VOT, UAV123 and plain folders."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core.otb import DataError, open_dataset, score
from mfcmt_core.otb.layouts import detect
from mfcmt_core.otb.video import read_video_frame

from .test_dataset import images, truth


def test_got10k_is_opened_with_its_boxes_as_they_are(tmp_path: Path) -> None:
    for k in (2, 1):
        folder = tmp_path / f"GOT-10k_Val_{k:06d}"
        images(folder, range(1, 6), digits=8)
        (folder / "groundtruth.txt").write_text("0.5000,-2.0000,30.0000,20.0000\n" * 5)
    dataset = open_dataset(tmp_path)
    assert (detect(tmp_path), dataset.name, len(dataset)) == ("got10k", "GOT-10k", 2)
    first = dataset["GOT-10k_Val_000001"]
    assert first.boxes[0].tolist() == [0.5, -2, 30, 20]
    assert first.valid.all()
    assert len(first.frames) == 5


def test_vot_is_opened_with_polygons_as_rectangles(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text("ball\nbag\nabsent\n")
    images(tmp_path / "ball" / "color", range(1, 4), digits=8)
    (tmp_path / "ball" / "groundtruth.txt").write_text("10,20,30,40\n" * 3)
    images(tmp_path / "bag" / "color", range(1, 3), digits=8)
    (tmp_path / "bag" / "groundtruth.txt").write_text("10,20,40,10,50,30,20,40\n" * 2)
    dataset = open_dataset(tmp_path)
    assert dataset.name == "VOT"
    assert dataset.missing == ("absent",)
    assert dataset["ball"].boxes[0].tolist() == [10, 20, 30, 40]
    assert dataset["bag"].boxes[0].tolist() == [10, 10, 40, 30]


def test_uav123_is_opened_in_parts_and_absent_targets_are_not_scored(tmp_path: Path) -> None:
    (tmp_path / "anno" / "UAV123").mkdir(parents=True)
    images(tmp_path / "data_seq" / "UAV123" / "bird1", range(770, 781), digits=6)
    truth(tmp_path / "anno" / "UAV123" / "bird1_2.txt", 4)
    images(tmp_path / "data_seq" / "UAV123" / "bike1", range(1, 4), digits=6)
    (tmp_path / "anno" / "UAV123" / "bike1.txt").write_text("5,5,10,10\nNaN,NaN,NaN,NaN\n5,5,10,10\n")
    truth(tmp_path / "anno" / "UAV123" / "boat1.txt", 3)
    dataset = open_dataset(tmp_path)
    assert dataset.missing == ("boat1",)
    assert dataset["bird1_2"].frames[0].name == "000775.jpg"
    bike = dataset["bike1"]
    assert bike.valid.tolist() == [True, False, True]
    result = score(dataset, {"bike1": np.tile(bike.boxes[0], (3, 1))})
    assert result.scores["bike1"].frames == 2
    assert result.precision == 1


def test_plain_folders_are_opened_with_boxes_that_count_from_1(tmp_path: Path) -> None:
    images(tmp_path / "mine" / "img", range(7, 10))
    truth(tmp_path / "mine" / "gt.txt", 3, " ")
    images(tmp_path / "other", range(3))
    truth(tmp_path / "other" / "groundtruth.txt", 3)
    dataset = open_dataset(tmp_path)
    assert list(dataset.sequences) == ["mine", "other"]
    assert dataset["mine"].boxes[0].tolist() == [9, 19, 30, 40]
    assert list(open_dataset(tmp_path / "mine").sequences) == ["mine"]


def test_what_cannot_be_used_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no sequence of"):
        open_dataset(tmp_path)
    images(tmp_path / "mine", range(1, 4))
    truth(tmp_path / "mine" / "gt.txt", 2)
    with pytest.raises(DataError, match=r"gt.txt: 2 boxes for 3 images"):
        open_dataset(tmp_path)
    (tmp_path / "mine" / "gt.txt").write_text("1,2,3,4\n1,2,3,4,5,6,7,8\n1,2,3,4\n")
    with pytest.raises(DataError, match=r"gt.txt:2: 8 numbers after lines of 4"):
        open_dataset(tmp_path)


def test_otb_is_recognised(annotations: Path, otb_root: Path) -> None:
    assert detect(annotations) == detect(otb_root) == "otb"


def film(path: Path, frames: int) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48))
    for k in range(frames):
        writer.write(np.full((48, 64, 3), 20 * k, np.uint8))
    writer.release()


def test_videos_are_opened_with_the_truth_beside_them(tmp_path: Path) -> None:
    film(tmp_path / "VOT-ball.avi", 6)
    (tmp_path / "VOT-ball.txt").write_text("10,20,30,40\n" * 3 + "nan,nan,nan,nan\n" + "10,20,30,40\n" * 2)
    film(tmp_path / "without.avi", 2)
    (tmp_path / "README.txt").write_text("no boxes")
    dataset = open_dataset(tmp_path)
    assert (detect(tmp_path), list(dataset.sequences)) == ("videos", ["VOT-ball"])
    ball = dataset["VOT-ball"]
    assert (ball.source, ball.is_video, len(ball)) == ("VOT", True, 6)
    assert ball.boxes[0].tolist() == [10, 20, 30, 40]
    assert ball.valid.tolist() == [True] * 3 + [False] + [True] * 2
    assert ball.image_size == (64, 48)
    for index in (0, 1, 4, 2, 5):  # in order, ahead and back
        assert ball.read(index).mean() == pytest.approx(20 * index, abs=2)
    with pytest.raises(DataError, match=r"VOT-ball\.avi: frame 6 cannot be read"):
        read_video_frame(tmp_path / "VOT-ball.avi", 6)


def test_a_video_shorter_than_its_truth_is_named(tmp_path: Path) -> None:
    film(tmp_path / "short.avi", 3)
    (tmp_path / "short.txt").write_text("10,20,30,40\n" * 5)
    with pytest.raises(DataError, match=r"short\.txt: 5 boxes for 3 frames"):
        open_dataset(tmp_path)
