"""Where runs start under OPE, TRE and SRE."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core.otb import Dataset, Sequence, ope, sre, tre
from mfcmt_core.otb.protocol import shifted, shifted_starts, to_original_size


def sequence(frames: int, *, omit: tuple[int, ...] = (), invalid: tuple[int, ...] = ()) -> Sequence:
    boxes = np.tile([9.0, 19.0, 40.0, 30.0], (frames, 1)) + np.arange(frames)[:, None] * [1, 0, 0, 0]
    valid = np.ones(frames, bool)
    valid[list(invalid)] = False
    startable = valid.copy()
    startable[list(omit)] = False
    return Sequence("made", (), boxes, valid, startable)


def test_ope_is_one_run_from_the_first_frame_on_the_true_box() -> None:
    (run,) = ope(sequence(50))
    assert (run.start, run.box, run.ratio) == (0, (9, 19, 40, 30), 1)


def test_shifted_starts_are_three_passes() -> None:
    runs = shifted_starts(sequence(50))
    assert [(r.key, r.start, r.box[0]) for r in runs] == [
        ("01", 0, 9),
        ("11", 10, 19),
        ("21", 20, 29),
    ]
    assert [r.start for r in shifted_starts(sequence(50, invalid=(0, 11)))] == [1, 21]
    assert [r.start for r in shifted_starts(sequence(15))] == [0, 10]


def test_tre_starts_by_the_rule_of_the_toolkit() -> None:
    """MATLAB: [floor(1:81/19:81) 81], 1-based: frame 81 of 100 is the last with 20 frames to go."""
    one_based = [1, 5, 9, 13, 18, 22, 26, 30, 35, 39, 43, 47, 52, 56, 60, 64, 69, 73, 77, 81]
    runs = tre(sequence(100))
    assert [run.start + 1 for run in runs] == one_based
    assert [run.key for run in runs] == [f"{k:02d}" for k in range(1, 21)]
    assert runs[4].box == (9 + 17, 19, 40, 30)


def test_tre_starts_neither_on_omitted_nor_on_invalid_frames() -> None:
    runs = tre(sequence(100, omit=tuple(range(3, 30)), invalid=(0, 40)))
    starts = [run.start for run in runs]
    assert len(starts) == 20
    assert starts == sorted(starts)
    assert starts[0] == 1
    assert starts[-1] == 80
    assert not set(starts) & {0, 40, *range(3, 30)}


def test_tre_of_a_short_sequence_has_fewer_runs_like_the_toolkit() -> None:
    """MATLAB: numel(1:6/19:6) is 16, and the last."""
    assert len(tre(sequence(25))) == 17
    assert [run.start for run in tre(sequence(10))] == [0]


def test_tre_has_20_valid_starts_on_every_target_of_otb(otb2015: Dataset) -> None:
    for target in otb2015:
        runs = tre(target)
        assert len(runs) == 20, target.name
        assert all(target.valid[run.start] and len(target) - run.start >= 20 for run in runs), target.name
    assert tre(otb2015["Tiger1"])[0].start == 0


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("left", (194, 214, 34, 81)),
        ("right", (202, 214, 34, 81)),
        ("up", (198, 205, 34, 81)),
        ("down", (198, 223, 34, 81)),
        ("topLeft", (195, 206, 37, 89)),
        ("topRight", (198, 206, 37, 89)),
        ("bottomLeft", (195, 214, 37, 89)),
        ("bottomRight", (198, 214, 37, 89)),
        ("scale_8", (201, 222, 27, 65)),
        ("scale_9", (200, 218, 31, 73)),
        ("scale_11", (196, 210, 37, 89)),
        ("scale_12", (195, 206, 41, 97)),
    ],
)
def test_sre_boxes_of_basketball_are_those_of_the_toolkit(key: str, expected: tuple[int, ...]) -> None:
    """The first box of Basketball is 198,214,34,81; ``left`` is the start of published SRE results."""
    assert shifted(np.array([198.0, 214, 34, 81]), key, (576, 432)).tolist() == list(expected)


def test_sre_boxes_stay_in_the_image_as_the_toolkit_clips_them() -> None:
    assert shifted(np.array([2.0, 3, 50, 60]), "left", (320, 240)).tolist() == [1, 3, 50, 60]
    assert shifted(np.array([2.0, 3, 50, 60]), "topLeft", (320, 240)).tolist() == [1, 1, 55, 66]
    assert shifted(np.array([270.0, 180, 50, 60]), "scale_12", (320, 240)).tolist() == [265, 174, 56, 67]


def test_sre_has_12_runs_and_knows_what_to_undo() -> None:
    runs = sre(sequence(50))
    assert len(runs) == 12
    assert {run.key: run.ratio for run in runs if run.ratio != 1} == {
        "scale_8": 0.8,
        "scale_9": 0.9,
        "scale_11": 1.1,
        "scale_12": 1.2,
    }


def test_boxes_of_a_scaled_run_go_back_to_the_original_size_and_whole_pixels() -> None:
    boxes = np.array([[101.0, 51.0, 48.0, 24.0], [10.4, 20.4, 36.0, 72.0]])
    back = to_original_size(boxes, 1.2)
    # centre 124.5, 62.5; size 40 x 20
    assert back[0].tolist() == [105, 53, 40, 20]
    assert to_original_size(boxes, 1.0) is boxes
