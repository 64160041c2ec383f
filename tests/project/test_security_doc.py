"""Every threat of the list has a row, and every row ends with tests that exist or says why there is none."""

from __future__ import annotations

import ast
import re

from tests.conftest import ROOT

ROWS = [str(n) for n in range(1, 45)] + ["12b", "13b"]
NAMED = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def rows() -> dict[str, str]:
    """The last cell of each threat by its number."""
    text = (ROOT / "docs" / "security.md").read_text(encoding="utf-8").split("## Threats")[1]
    found = re.findall(r"^\| (\d+b?) \|.*\| ([^|]+) \|$", text, re.M)
    assert len(found) == len(dict(found))
    return dict(found)


def test_every_threat_has_its_row() -> None:
    assert sorted(rows()) == sorted(ROWS)


def test_every_row_ends_with_a_test_that_exists_or_a_reason() -> None:
    for number, shown in rows().items():
        named = NAMED.findall(shown)
        assert named or shown.startswith("Not tested, because "), f"row {number}: {shown}"
        for path, name in named:
            assert name in names(path), f"row {number}: {path} has no {name}"


def test_every_limit_is_a_setting() -> None:
    from service.settings import Settings

    text = (ROOT / "docs" / "security.md").read_text(encoding="utf-8").split("## Limits")[1].split("## Threats")[0]
    named = set(re.findall(r"`([a-z_]+_[a-z_]+)`", text)) | {f"max_frame_{n}" for n in ("pixels", "side_px", "scans")}
    assert {name for name in named if not name.startswith("_")} <= set(Settings.model_fields)


def names(path: str) -> set[str]:
    """What a test file defines at its top: functions, classes, and classes made by calls."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    found = {n.name for n in tree.body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)}
    return found | {t.id for n in tree.body if isinstance(n, ast.Assign) for t in n.targets if isinstance(t, ast.Name)}
