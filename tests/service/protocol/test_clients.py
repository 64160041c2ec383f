"""What the clients repeat of the protocol, for type checkers and browsers, is what the protocol says."""

from __future__ import annotations

import re
from typing import get_args

from service.client import connection, types
from service.client.errors import _BY_CLOSE_CODE
from service.protocol.codecs import CODECS
from service.protocol.enums import CloseCode, Mode, ProblemCode
from service.protocol.problems import CATALOGUE
from tests.conftest import ROOT

JS = ROOT / "service/web/client/lib"
# A client reconnects after these.
MAY_PASS = {
    CloseCode.GOING_AWAY,
    CloseCode.INTERNAL,
    CloseCode.RESTART,
    CloseCode.AT_CAPACITY,
    CloseCode.ELSEWHERE,
}


def test_the_python_clients_literals_are_the_closed_sets() -> None:
    assert set(get_args(connection.Protocol)) == set(CODECS)
    assert set(get_args(types.Mode)) == set(Mode)


def test_a_client_knows_what_every_final_close_code_means() -> None:
    assert set(_BY_CLOSE_CODE) == set(CloseCode) - MAY_PASS


def test_the_javascript_client_reads_close_codes_as_the_python_client_does() -> None:
    block = re.search(r"BY_CLOSE_CODE = \{(.*?)\n\};", (JS / "errors.js").read_text(), re.S)
    assert block is not None
    rows = re.findall(r'(\d{4}): \{ code: "([a-z-]+)", status: (\d{3})(?:, reason: "(\w+)")? \}', block[1])
    found = {int(close): (code, int(status), reason or None) for close, code, status, reason in rows}
    assert found == {
        int(close): (code.value, CATALOGUE[code].status, None if reason is None else reason.value)
        for close, (code, reason) in _BY_CLOSE_CODE.items()
    }


def test_the_javascript_client_speaks_the_subprotocols_and_names_problems_that_exist() -> None:
    assert set(re.findall(r'subprotocol: "([^"]+)"', (JS / "codec.js").read_text())) == set(CODECS)
    block = re.search(r"BY_STATUS = \{(.*?)\n\};", (JS / "errors.js").read_text(), re.S)
    assert block is not None
    for status, code in re.findall(r'(\d{3}): "([a-z-]+)"', block[1]):
        assert CATALOGUE[ProblemCode(code)].status == int(status)
