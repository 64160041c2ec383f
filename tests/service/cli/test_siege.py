"""The command that attacks, in its short form; times are for the long form, on a machine that is not busy."""

from __future__ import annotations

import json

import pytest

from mfcmt_core.cli import main
from tests.tools.siege.attacks import ATTACKS
from tests.tools.siege.outcome import BOUND_BYTES


def test_the_service_is_whole_after_every_attack(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing ends or fails, the neighbour goes on, and the front stays within its bound."""
    assert main(["siege", "--short", "--json"]) in (0, 1)
    outcomes = json.loads(capsys.readouterr().out)
    assert [outcome["attack"] for outcome in outcomes] == [attack.name for attack in ATTACKS]
    assert {outcome["attack"]: outcome["damage"] for outcome in outcomes if outcome["damage"]} == {}
    assert max(outcome["front_bytes"] for outcome in outcomes) <= BOUND_BYTES
    assert sum(bool(outcome["answers"]) for outcome in outcomes) > len(ATTACKS) / 2
    with capsys.disabled():
        longest = max(outcomes, key=lambda outcome: outcome["stall_s"])
        print(f"\nlongest stretch {longest['stall_s'] * 1e3:.1f} ms of processor time: {longest['attack']}")


def test_attacks_have_names_of_their_own_and_can_be_chosen(capsys: pytest.CaptureFixture[str]) -> None:
    assert len({attack.name for attack in ATTACKS}) == len(ATTACKS)
    assert main(["siege", "--list", "--only", "pings"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert len(listed) > 1
    assert all("pings" in line for line in listed)
    assert main(["siege", "--only", "nothing of the kind"]) == 2
