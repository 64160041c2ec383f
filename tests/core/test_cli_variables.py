"""Variables that nothing reads are told, with the nearest name that something reads."""

from __future__ import annotations

import os

import pytest

from mfcmt_core.cli import main
from mfcmt_core.cli.variables import misspelt_variables, unread_variables


@pytest.fixture(autouse=True)
def _bare(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.startswith("MFCMT_"):
            monkeypatch.delenv(name)


def test_the_nearest_known_name_is_proposed(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = ["MFCMT_LANES", "MFCMT_PORT", "MFCMT_STATE_DIR"]
    assert unread_variables(settings) == []
    for name in (*settings, "MFCMT_OTB_ROOT", "MFCMT_CI"):
        monkeypatch.setenv(name, "1")
    assert unread_variables(settings) == []
    for name in ("MFCMT_LANE", "MFCMT_STATEDIR", "MFCMT_COLOUR", "mfcmt_lanes"):
        monkeypatch.setenv(name, "1")
    assert unread_variables(settings) == [
        "MFCMT_COLOUR is not read by anything",
        "MFCMT_LANE is not read by anything; did you mean MFCMT_LANES?",
        "MFCMT_STATEDIR is not read by anything; did you mean MFCMT_STATE_DIR?",
    ]


def test_what_kubernetes_sets_is_not_a_misspelling(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SERVICE_HOST", "SERVICE_PORT", "SERVICE_PORT_HTTP", "PORT_8000_TCP", "PORT_8000_TCP_ADDR"):
        monkeypatch.setenv(f"MFCMT_{name}", "10.0.0.1")
        monkeypatch.setenv(f"MFCMT_FRONT_{name}", "10.0.0.1")
    monkeypatch.setenv("MFCMT_FRONT_PORT", "tcp://10.0.0.1:8000")
    assert unread_variables(["MFCMT_PORT"]) == []


def test_eval_and_bench_warn_about_their_own_variable_only(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MFCMT_OTB_ROT", "/data")
    monkeypatch.setenv("MFCMT_LANES", "2")
    complaint = "MFCMT_OTB_ROT is not read by anything; did you mean MFCMT_OTB_ROOT?"
    assert misspelt_variables() == [complaint]
    assert main(["eval", "--data", "nowhere"]) == 2
    assert capsys.readouterr().err.splitlines()[0] == f"mfcmt eval: {complaint}"
