"""The system's browser, for the tests that open a page."""

from __future__ import annotations

import shutil

from .conftest import require

FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
NAMES = ("chromium", "chromium-browser", "google-chrome")


def chromium() -> str:
    """Where it is; skips the test where there is none."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    require(found, "no Chromium is installed")
    assert found
    return found
