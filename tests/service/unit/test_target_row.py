"""A target's confidence in rows and messages: it travels, and rows of before are read without it."""

from __future__ import annotations

from mfcmt_core import TrackResult
from service.lanes.rows import from_row, to_row
from service.protocol.target import row_to_map

RESULT = TrackResult((1.0, 2.0, 3.0, 4.0), "uncertain", False, None, None, 5.0, False, 1.0, confidence=0.25)


def test_confidence_travels_in_rows_and_messages():
    row = to_row(7, RESULT)
    assert from_row(row) == RESULT
    assert row_to_map(row)["confidence"] == 0.25


def test_a_row_of_before_has_no_confidence():
    row = to_row(7, RESULT)[:-1]
    assert row_to_map(row)["confidence"] is None
    assert from_row(row).box == RESULT.box
