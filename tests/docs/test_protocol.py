"""What is made from the protocol's definitions is as they are."""

from __future__ import annotations

import re

import pytest

from service.protocol.enums import CloseCode, ProblemCode
from service.protocol.problems import CATALOGUE

from . import protocol, typescript


@pytest.mark.parametrize("path", protocol.MADE, ids=lambda path: path.name)
def test_what_is_made_from_the_protocol_is_fresh(path: object) -> None:
    """`make guide` writes it."""
    text = path.read_text(encoding="utf-8")  # type: ignore[attr-defined]
    assert protocol.MADE[path](text) == text  # type: ignore[index]


def test_the_document_has_every_table() -> None:
    text = protocol.DOCUMENT.read_text(encoding="utf-8")
    assert set(re.findall(r"<!-- table: ([a-z ]+) -->", text)) == set(protocol.TABLES)


def test_the_tables_name_every_problem_and_close_code() -> None:
    problems, closes = protocol.problems_table(), protocol.closes_table()
    assert all(f"| `{code}` | {CATALOGUE[code].status} |" in problems for code in ProblemCode)
    assert all(f"| {code.value} | " in closes for code in CloseCode)


def test_the_types_have_every_problem_code() -> None:
    codes = re.search(r"type ProblemCode =(.*?);", typescript.generated(), re.S)
    assert codes is not None
    assert re.findall(r'"([a-z-]+)"', codes[1]) == list(ProblemCode)


def test_links_within_the_document_lead_somewhere() -> None:
    text = protocol.DOCUMENT.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    anchors = {re.sub(r"[^a-z -]", "", heading.lower()).replace(" ", "-") for heading in headings}
    assert set(re.findall(r"\]\(#([a-z-]+)\)", text)) <= anchors
