"""A port or an address that cannot be had is one line, which names the variable to change."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator

import pytest

from mfcmt_core.cli import main
from service.cli.address import CannotListen, check_free
from service.load.own import OwnServer, free_port


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that something listens on."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening.getsockname()[1]


@pytest.mark.parametrize("command", [["serve"], ["demo", "--no-browser"]])
def test_a_port_in_use_is_one_line(
    taken: int, command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    complaint = f"mfcmt {command[0]}: port {taken} is in use; choose another, as with MFCMT_PORT={taken + 1}\n"
    assert main([*command, "--port", str(taken)]) == 1
    assert capsys.readouterr().err == complaint
    monkeypatch.setenv("MFCMT_PORT", str(taken))
    assert main(command) == 1
    assert capsys.readouterr().err == complaint


@pytest.mark.parametrize("command", [["demo", "--no-browser"], ["health"]])
@pytest.mark.parametrize("port", ["tcp://10.0.0.1:8000", "70000", "-1", ""])
def test_a_port_that_is_none_is_one_line(
    command: list[str], port: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MFCMT_PORT", port)
    assert main(command) == 2
    assert capsys.readouterr().err == f"mfcmt {command[0]}: MFCMT_PORT is a number from 0 to 65535\n"


def test_an_address_of_another_machine_names_the_variable() -> None:
    check_free("127.0.0.1", free_port())
    check_free("127.0.0.1", 0)
    for host in ("192.0.2.1", "no such host"):
        with pytest.raises(CannotListen, match="MFCMT_HOST"):
            check_free(host, 0)


def test_a_misspelt_setting_is_a_line_of_the_log() -> None:
    environment = {"MFCMT_LANE": "3", "MFCMT_OTB_ROOT": "/data", "MFCMT_CI": "1"}
    with OwnServer(lanes=1, environment=environment) as server:
        lines = [json.loads(line) for line in server.log.splitlines()]
    complaint = [line["event"] for line in lines if "not read" in line["event"]]
    assert complaint == ["MFCMT_LANE is not read by anything; did you mean MFCMT_LANES?"]
    assert {line["level"] for line in lines if "not read" in line["event"]} == {"warning"}


def test_health_tells_of_a_misspelt_variable_where_nothing_answers(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MFCMT_PROT", "9000")
    assert main(["health", "--port", str(free_port())]) == 1
    assert "did you mean MFCMT_PORT?" in capsys.readouterr().err
