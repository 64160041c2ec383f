"""Shared fixtures: where the real sequences are, and skips that CI does not accept."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
OTB_ROOT = Path(os.environ.get("MFCMT_OTB_ROOT", ROOT.parent / "shared" / "data" / "otb"))


def require(condition: object, reason: str) -> None:
    """Skip with the reason where something is absent; fail where MFCMT_CI says that it must be there."""
    if not condition:
        (pytest.fail if os.environ.get("MFCMT_CI") else pytest.skip)(reason)


@pytest.fixture(scope="session")
def otb_root() -> Path:
    """The folder of real OTB sequences."""
    require(OTB_ROOT.is_dir(), f"no OTB sequences at {OTB_ROOT} (set MFCMT_OTB_ROOT)")
    return OTB_ROOT
