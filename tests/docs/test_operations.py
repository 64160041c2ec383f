"""The operator's guide is complete and says what is so."""

from __future__ import annotations

import re

import pytest

from service.protocol.problems import CATALOGUE
from service.settings import Settings
from tests.conftest import ROOT

from .tables import GUIDE, TABLES, block

TEXT = GUIDE.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", TABLES)
def test_generated_tables_are_fresh(name: str) -> None:
    found = block(name).search(TEXT)
    assert found is not None
    assert found[2] == TABLES[name](), "make guide writes it anew"


def test_every_setting_is_in_the_guide_and_no_other() -> None:
    named = set(re.findall(r"MFCMT_[A-Z_]+[A-Z]", TEXT))
    fields = {f"MFCMT_{name.upper()}" for name in Settings.model_fields}
    assert fields <= named
    assert named - fields <= {"MFCMT_OTB_ROOT"}


def test_labels_take_their_values_from_closed_sets() -> None:
    groups = re.findall(r"(?:counter|gauge) by (.*?) \|", TABLES["metrics"]())
    named = {label.strip("`") for group in groups for label in group.split(", ")}
    assert named <= {"code", "reason", "cause", "preset", "via", "status", "lane", "version", "opencv", "numpy", "what"}


def test_every_problem_that_an_operator_causes_is_explained() -> None:
    for code in (
        "at-capacity",
        "rate-limited",
        "draining",
        "deadline-exceeded",
        "internal",
        "origin-refused",
        "host-refused",
    ):
        assert code in CATALOGUE
        assert f"`{code}`" in TEXT


def test_every_file_that_the_guide_names_exists() -> None:
    made_here = {line.removeprefix("/") for line in (ROOT / ".gitignore").read_text().splitlines()}
    for path in re.findall(r"`((?:docker|docs|tests)/[\w./-]+)`", TEXT):
        assert path in made_here or (ROOT / path).exists(), path
    for path in re.findall(r"\]\(([\w./-]+\.md)(?:#[\w-]+)?\)", TEXT):
        assert (GUIDE.parent / path).exists(), path
