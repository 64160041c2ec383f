"""The tests that `make test-fast` leaves out."""

from __future__ import annotations

from tests.conftest import ROOT, SLOW


def test_what_is_called_slow_is_there() -> None:
    for place in SLOW:
        assert (ROOT / "tests" / place).exists(), place
