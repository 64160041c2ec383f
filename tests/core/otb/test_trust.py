"""The figures about a tracker's own word, on cases that a person can count."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mfcmt_core.otb.trust import (
    Judged,
    Pool,
    absent_tracked,
    auroc,
    calibration,
    caught,
    long_term,
    measure,
    risk_coverage,
    status_table,
    tracked_wrong,
)

TRACKING, UNCERTAIN, LOST = 0, 1, 2
NAN = math.nan


def judged(name, overlap, confidence, status=None):
    n = len(overlap)
    return Judged(name, *(np.array(v, float) for v in (overlap, confidence, status or [NAN] * n)))


def test_auroc_counts_pairs_and_half_of_the_ties():
    right = np.array([True, True, False, False])
    ones = np.ones(4)
    assert auroc(np.array([4.0, 3, 2, 1]), right, ones) == 1
    assert auroc(np.array([1.0, 2, 3, 4]), right, ones) == 0
    assert auroc(np.array([4.0, 2, 3, 1]), right, ones) == 0.75
    assert auroc(np.zeros(4), right, ones) == 0.5
    assert math.isnan(auroc(np.zeros(4), np.ones(4, bool), ones))


def test_auroc_counts_frames_by_their_weight():
    score, right = np.array([3.0, 2, 1]), np.array([True, False, True])
    assert auroc(score, right, np.array([3.0, 1, 1])) == 0.75


def test_caught_is_the_share_of_wrong_frames_below_what_one_in_twenty_right_ones_is_below():
    confidence = np.concatenate([np.linspace(0.05, 1, 20), [0.01, 0.04, 0.06, 0.9]])
    right = np.arange(24) < 20
    assert caught(confidence, right, ~right, np.ones(24)) == 0.5  # the limit is 0.05
    assert caught(confidence, right, ~right, np.ones(24), refused=0.1) == 0.75  # 0.1
    assert math.isnan(caught(confidence, ~right & False, ~right, np.ones(24)))


def test_calibration_error_is_the_mean_distance_of_confidence_and_truth():
    confidence = np.array([0.85, 0.85, 0.85, 0.85, 0.15, 0.15])
    right = np.array([True, True, True, False, False, False])
    c = calibration(confidence, right, np.ones(6))
    assert c.right[8] == 0.75
    assert c.error == pytest.approx(4 / 6 * 0.1 + 2 / 6 * 0.15)
    assert calibration(np.array([1.0]), np.array([True]), np.ones(1)).error == 0


def test_risk_falls_as_less_is_accepted():
    coverage, risk = risk_coverage(np.array([0.9, 0.8, 0.7, 0.6]), np.array([True, True, False, False]), np.ones(4))
    assert coverage.tolist() == [0.25, 0.5, 0.75, 1]
    assert risk.tolist() == pytest.approx([0, 0, 1 / 3, 0.5])


def test_each_sequence_weighs_alike_and_absent_frames_not_at_all():
    pool = Pool.of([judged("long", [0.9] * 4, [0.5] * 4), judged("short", [0.9, NAN], [0.5, 0.5])])
    assert pool.weight.tolist() == [0.25] * 4 + [1]


def test_status_table_has_a_row_for_each_truth():
    pool = Pool.of([judged("a", [0.9, 0.6, 0.3, 0.05, 0], [1] * 5, [TRACKING, LOST, UNCERTAIN, TRACKING, LOST])])
    right, between, wrong = status_table(pool).tolist()
    assert right == [0.5, 0, 0.5]
    assert between == [0, 1, 0]
    assert wrong == [0.5, 0, 0.5]
    assert tracked_wrong(pool) == 0.5


def test_long_term_measures_are_taken_at_the_threshold_of_the_largest_f():
    """Two frames with the target, found at 0.8 and missed; one without it, on which a sure box lies."""
    film = judged("film", [0.8, 0.0, NAN], [0.9, 0.1, 0.5])
    best = long_term([film])
    assert best.threshold == 0.9  # only the first box is given
    assert (best.precision, best.recall) == pytest.approx((0.8, 0.4))
    assert best.f == pytest.approx(2 * 0.8 * 0.4 / 1.2)


def test_absent_frames_that_are_called_tracking_are_counted():
    film = judged("film", [0.8, NAN, NAN, NAN], [1] * 4, [TRACKING, TRACKING, LOST, UNCERTAIN])
    assert absent_tracked([film, judged("whole", [0.8], [1], [TRACKING])]) == pytest.approx(1 / 3)
    assert math.isnan(absent_tracked([judged("whole", [0.8], [1], [TRACKING])]))


def test_a_number_that_is_no_probability_has_no_calibration_error():
    films = [judged(str(k), [0.9, 0.8, 0.05], [12.0, 9.0, 5.0]) for k in range(3)]
    trust = measure(films)
    assert trust.auroc == trust.caught == 1
    assert trust.auroc_interval == (1, 1)
    assert math.isnan(trust.calibration_error)
    assert trust.sequences == 3
