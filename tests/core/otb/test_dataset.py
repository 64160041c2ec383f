"""Folders as OTB distributes them, and what is wrong with some."""

from __future__ import annotations

from collections.abc import Sequence as Seq
from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core.images.files import list_images
from mfcmt_core.otb import (
    ATTRIBUTES,
    DataError,
    Dataset,
    open_otb,
    otb_targets,
    read_boxes,
    read_result,
    write_boxes,
)

# the names of the 98 folders and counts that the benchmark's page gives
TOTALS = {
    "IV": 38,
    "OPR": 63,
    "SV": 64,
    "OCC": 49,
    "DEF": 44,
    "MB": 29,
    "FM": 39,
    "IPR": 51,
    "OV": 14,
    "BC": 31,
    "LR": 9,
}


def images(folder: Path, numbers: Seq[int], digits: int = 4) -> None:
    folder.mkdir(parents=True)
    data = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    for number in numbers:
        (folder / f"{number:0{digits}d}.jpg").write_bytes(data)


def truth(path: Path, lines: int, delimiter: str = ",") -> None:
    path.write_text("".join(delimiter.join(map(str, (10 + i, 20, 30, 40))) + "\n" for i in range(lines)))


def test_the_table_of_targets_has_the_totals_of_the_benchmark() -> None:
    assert len(otb_targets()) == 100
    assert len(otb_targets("OTB-2013")) == 51
    assert len(otb_targets("TB-50")) == 50
    assert list(ATTRIBUTES) == list(TOTALS)
    assert {a: sum(a in t.attributes for t in otb_targets()) for a in ATTRIBUTES} == TOTALS


def test_annotations_alone_make_the_100_targets_of_the_benchmark(otb2015: Dataset) -> None:
    assert len(otb2015) == 100
    assert not otb2015.missing
    assert sum(map(len, otb2015)) == 59040 - 5  # Tiger1 starts at frame 6
    assert {s.name: int((~s.valid).sum()) for s in otb2015 if not s.valid.all()} == {
        "Biker": 7,
        "Board": 1,
        "Crowds": 1,
        "Twinnings": 1,
    }


def test_the_real_sequences_have_a_frame_for_each_box(otb_root: Path) -> None:
    dataset = open_otb(otb_root)
    assert dataset.coverage == f"{len(dataset)} of 100"
    for sequence in dataset:
        assert len(sequence.frames) == len(sequence)
    david = dataset["David"]
    assert (david.first, david.last, david.frames[0].name) == (300, 770, "0300.jpg")
    assert david.boxes[0].tolist() == [128, 79, 64, 78]
    assert david.image_size == (320, 240)


@pytest.mark.parametrize("delimiter", [",", "\t", " ", ", "])
def test_boxes_are_read_whatever_delimits_their_numbers(tmp_path: Path, delimiter: str) -> None:
    truth(tmp_path / "boxes.txt", 3, delimiter)
    assert read_boxes(tmp_path / "boxes.txt").tolist() == [[10 + i, 20, 30, 40] for i in range(3)]


def test_a_late_start_is_found_in_a_whole_folder_and_in_a_cut_one(tmp_path: Path) -> None:
    images(tmp_path / "whole" / "David" / "img", range(1, 771))
    truth(tmp_path / "whole" / "David" / "groundtruth_rect.txt", 471)
    images(tmp_path / "cut" / "BlurCar3" / "img", range(3, 360))
    truth(tmp_path / "cut" / "BlurCar3" / "groundtruth_rect.txt", 357)
    assert open_otb(tmp_path / "whole")["David"].frames[0].name == "0300.jpg"
    assert open_otb(tmp_path / "cut")["BlurCar3"].frames[0].name == "0003.jpg"


def test_images_may_have_five_digits_and_be_more_than_the_annotations(tmp_path: Path) -> None:
    images(tmp_path / "Board" / "img", range(1, 699), digits=5)
    truth(tmp_path / "Board" / "groundtruth_rect.txt", 698)
    images(tmp_path / "Football1" / "img", range(1, 82))
    truth(tmp_path / "Football1" / "groundtruth_rect.txt", 74)
    dataset = open_otb(tmp_path)
    assert dataset["Board"].frames[-1].name == "00698.jpg"
    assert len(dataset["Football1"].frames) == 74


def test_tiger1_starts_at_frame_6_as_in_the_published_results(tmp_path: Path) -> None:
    images(tmp_path / "Tiger1" / "img", range(1, 355))
    truth(tmp_path / "Tiger1" / "groundtruth_rect.txt", 354)
    tiger = open_otb(tmp_path)["Tiger1"]
    assert (tiger.first, len(tiger), tiger.frames[0].name) == (6, 349, "0006.jpg")
    assert tiger.boxes[0, 0] == 10 + 5 - 1


@pytest.mark.parametrize("spelling", ["one folder", "two folders", "dotted"])
def test_two_targets_of_one_sequence_are_found_in_each_spelling(tmp_path: Path, spelling: str) -> None:
    names = {
        "one folder": ["Jogging"],
        "two folders": ["Jogging-1", "Jogging-2"],
        "dotted": ["Jogging.1", "Jogging.2"],
    }
    for name in names[spelling]:
        images(tmp_path / name / "img", range(1, 308))
        if spelling == "one folder":
            truth(tmp_path / name / "groundtruth_rect.1.txt", 307)
            truth(tmp_path / name / "groundtruth_rect.2.txt", 307)
        else:
            truth(tmp_path / name / "groundtruth_rect.txt", 307)
    assert list(open_otb(tmp_path).sequences) == ["Jogging-1", "Jogging-2"]


def test_what_is_missing_is_listed(tmp_path: Path) -> None:
    images(tmp_path / "Deer" / "img", range(1, 72))
    truth(tmp_path / "Deer" / "groundtruth_rect.txt", 71)
    dataset = open_otb(tmp_path)
    assert dataset.coverage == "1 of 100"
    assert len(dataset.missing) == 99
    with pytest.raises(DataError, match="has no Basketball"):
        dataset.select(["Deer", "Basketball"])


def test_bad_data_is_named_by_file_and_line(tmp_path: Path) -> None:
    images(tmp_path / "Deer" / "img", range(1, 72))
    file = tmp_path / "Deer" / "groundtruth_rect.txt"
    truth(file, 71)
    rows = file.read_text().splitlines()

    file.write_text("\n".join([*rows[:4], "1,2,x,4", *rows[5:]]))
    with pytest.raises(DataError, match=r"groundtruth_rect.txt:5: not numbers: '1,2,x,4'"):
        open_otb(tmp_path)
    file.write_text("\n".join([*rows[:6], "1,2,3", *rows[7:]]))
    with pytest.raises(DataError, match=r"groundtruth_rect.txt:7: 3 numbers"):
        open_otb(tmp_path)
    file.write_text("\n".join(rows[:70]))
    with pytest.raises(DataError, match=r"groundtruth_rect.txt: 70 boxes for the frames 1 to 71"):
        open_otb(tmp_path)
    file.write_text("")
    with pytest.raises(DataError, match=r"groundtruth_rect.txt: is empty"):
        open_otb(tmp_path)
    file.unlink()
    with pytest.raises(DataError, match=r"Deer: has no groundtruth_rect.txt"):
        open_otb(tmp_path)
    truth(file, 71)
    (tmp_path / "Deer" / "img" / "0040.jpg").unlink()
    with pytest.raises(DataError, match=r"1 of the images 1 to 71 are missing, first number 40"):
        open_otb(tmp_path)
    with pytest.raises(DataError, match="no such folder"):
        open_otb(tmp_path / "nowhere")


def test_files_that_a_system_hides_are_no_frames(tmp_path: Path) -> None:
    images(tmp_path / "img", range(1, 4))
    (tmp_path / "img" / "._0001.jpg").write_bytes(b"not a picture")
    assert [file.name for file in list_images(tmp_path / "img")] == ["0001.jpg", "0002.jpg", "0003.jpg"]


def test_a_file_that_is_no_image_is_named(tmp_path: Path) -> None:
    images(tmp_path / "Deer" / "img", range(1, 72))
    truth(tmp_path / "Deer" / "groundtruth_rect.txt", 71)
    (tmp_path / "Deer" / "img" / "0002.jpg").write_bytes(b"not a picture")
    with pytest.raises(DataError, match=r"cannot read .*0002.jpg: not a JPEG, PNG or WebP image"):
        open_otb(tmp_path)["Deer"].read(1)


def test_result_files_go_back_and_forth(tmp_path: Path, otb2015: Dataset) -> None:
    david = otb2015["David"]
    write_boxes(tmp_path / "David.txt", david.boxes)
    assert (tmp_path / "David.txt").read_text().startswith("129.000,80.000,64.000,78.000\n119.000,78.000,")
    assert np.array_equal(read_result(tmp_path / "David.txt", david), david.boxes)
    assert np.array_equal(read_result(tmp_path / "David.txt", david, start=0)[5:], david.boxes[5:])


def test_longer_result_files_are_cut_and_shorter_ones_refused(tmp_path: Path, otb2015: Dataset) -> None:
    tiger = otb2015["Tiger1"]
    whole = np.vstack([np.full((5, 4), 7.0), tiger.boxes])
    write_boxes(tmp_path / "from-frame-1.txt", whole)
    assert np.array_equal(read_result(tmp_path / "from-frame-1.txt", tiger), tiger.boxes)
    football = otb2015["Football1"]
    write_boxes(tmp_path / "longer.txt", np.vstack([football.boxes, football.boxes[:7]]))
    assert np.array_equal(read_result(tmp_path / "longer.txt", football), football.boxes)
    write_boxes(tmp_path / "shorter.txt", football.boxes[:70])
    with pytest.raises(DataError, match=r"shorter.txt: 70 boxes for 74 frames"):
        read_result(tmp_path / "shorter.txt", football)
