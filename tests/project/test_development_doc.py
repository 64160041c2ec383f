"""docs/development.md names files; each must exist."""

from __future__ import annotations

import re

from tests.conftest import ROOT

TEXT = (ROOT / "docs" / "development.md").read_text(encoding="utf-8")
FOLDERS = ("", "mfcmt_core", "service", "docs")


def test_every_file_that_the_document_names_exists() -> None:
    named = set(re.findall(r"`([\w./-]+/[\w./-]*\w|\w+\.(?:py|js|ts|md|html))`", TEXT))
    assert len(named) > 40
    missing = [path for path in named if not any((ROOT / folder / path).exists() for folder in FOLDERS)]
    assert missing == []
