"""Metrics and the rules by which frames become scores."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mfcmt_core.otb import DataError, Dataset, Run, Sequence, metrics, score, score_runs

BOXES = arrays(np.float64, (5, 4), elements=st.floats(1, 200)).map(np.round)


def sequence(boxes: list[list[float]], name: str = "made", skip_invalid: bool = False) -> Sequence:
    rows = np.array(boxes, dtype=np.float64)
    valid = np.all(rows > 0, axis=1)
    return Sequence(name, (), rows, valid, valid, skip_invalid=skip_invalid)


def test_overlap_is_intersection_over_union() -> None:
    a = np.array([[0.0, 0, 10, 10], [0, 0, 10, 10], [0, 0, 10, 10], [0, 0, 0, 0]])
    b = np.array([[0.0, 0, 10, 10], [5, 0, 10, 10], [10, 0, 10, 10], [0, 0, 0, 0]])
    assert metrics.overlap(a, b).tolist() == [1, pytest.approx(1 / 3), 0, 0]


def test_center_error_counts_pixels_like_the_toolkit() -> None:
    a, b = np.array([[1.0, 1, 11, 11]]), np.array([[4.0, 5, 11, 11]])
    assert metrics.center_error(a, b).tolist() == [5]
    assert metrics.normalized_center_error(a, b)[0] == pytest.approx(5 / 11)


@given(BOXES, BOXES)
def test_overlap_is_symmetric_and_within_0_and_1(a: np.ndarray, b: np.ndarray) -> None:
    there, back = metrics.overlap(a, b), metrics.overlap(b, a)
    assert np.allclose(there, back)
    assert (there >= 0).all()
    assert (there <= 1 + 1e-12).all()


@given(BOXES, BOXES)
def test_curves_are_monotone(a: np.ndarray, b: np.ndarray) -> None:
    assert (np.diff(metrics.success_curve(metrics.overlap(a, b))) <= 0).all()
    assert (np.diff(metrics.precision_curve(metrics.center_error(a, b))) >= 0).all()


def test_a_perfect_tracker_scores_20_of_21_thresholds() -> None:
    truth = [[10.0, 10, 20, 20]] * 30
    result = score(Dataset("d", {"made": sequence(truth)}), {"made": truth})
    assert result.success == pytest.approx(20 / 21)
    assert result.precision == result.norm_precision == 1


def test_the_first_box_is_the_truth_and_a_lost_one_is_the_one_before() -> None:
    truth = sequence([[10.0, 10, 20, 20]] * 4)
    nan = float("nan")
    boxes = [[500.0, 500, 1, 1], [10, 10, 20, 20], [nan, nan, nan, nan], [90, 90, 0, 20]]
    assert score_runs(truth, [(Run("", 0, (0, 0, 1, 1)), boxes)]).precision == 1


def test_an_invalid_annotation_is_lost_for_success_and_found_for_precision() -> None:
    truth = [[10.0, 10, 20, 20], [10, 10, 20, 20], [0, 0, 0, 0], [10, 10, 20, 20]]
    run = Run("", 0, (10, 10, 20, 20))
    kept = score_runs(sequence(truth), [(run, truth)])
    assert kept.success == pytest.approx(0.75 * 20 / 21)
    assert kept.precision == 1
    skipped = score_runs(sequence(truth, skip_invalid=True), [(run, truth)])
    assert skipped.success == pytest.approx(20 / 21)
    assert skipped.frames == 3


def test_runs_pool_their_frames() -> None:
    truth = sequence([[10.0, 10, 20, 20]] * 10)
    far = np.tile([200.0, 200, 20, 20], (4, 1))
    whole = Run("01", 0, (10, 10, 20, 20)), truth.boxes
    late = Run("02", 6, (10, 10, 20, 20)), far
    # 10 frames found, and of 4 the first, which is the truth
    assert score_runs(truth, [whole, late]).precision == pytest.approx(11 / 14)


def test_nothing_is_averaged_over_what_is_missing() -> None:
    truth = [[10.0, 10, 20, 20]] * 3
    dataset = Dataset("d", {"a": sequence(truth, "a"), "b": sequence(truth, "b")})
    result = score(dataset, {"a": truth})
    assert list(result.scores) == ["a"]
    assert result.missing == {"b": "no boxes"}
    with pytest.raises(DataError, match="no OPE result"):
        result.mean("success", ["b"])


def test_boxes_must_be_one_a_frame() -> None:
    truth = [[10.0, 10, 20, 20]] * 3
    with pytest.raises(DataError, match="for 3 frames"):
        score(Dataset("d", {"a": sequence(truth, "a")}), {"a": truth[:2]})
