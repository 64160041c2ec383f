"""What is missing is told before a test that needs it fails."""

from __future__ import annotations

import sys

import pytest

from tests import chromium


def test_a_playwright_that_does_not_start_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a library is missing that its Node wants."""
    driver = pytest.importorskip("playwright._impl._driver")
    broken = "import sys; sys.exit('libatomic.so.1: cannot open shared object file')"
    monkeypatch.setattr(chromium.subprocess, "run", _run_instead([sys.executable, "-c", broken]))
    assert driver.compute_driver_executable()
    assert "libatomic.so.1" in chromium._trouble_of_playwright.__wrapped__()


def _run_instead(call: list[str]) -> object:
    real = chromium.subprocess.run
    return lambda _, **options: real(call, **options)
