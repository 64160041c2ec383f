"""The markers that tests have by their place."""

from __future__ import annotations

from tests.conftest import MARKED


def test_places_of_markers_exist() -> None:
    for places in MARKED.values():
        for place in places:
            assert place.exists(), place
