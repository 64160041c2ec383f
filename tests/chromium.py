"""The system's browser, for the tests that open a page."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from importlib.util import find_spec

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
    """Where it is; skips the test where there is none, or where Playwright cannot drive one.

    To be called before Playwright starts, which fails in its own way where something is missing.
    """
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    require(found, "no Chromium is installed")
    assert found
    trouble = _trouble_of_playwright()
    require(not trouble, trouble)
    return found


@cache
def _trouble_of_playwright() -> str:
    """Why Playwright's driver does not run here; empty if it does."""
    if not find_spec("playwright"):
        return "playwright is not installed"
    from playwright._impl._driver import compute_driver_executable

    done = subprocess.run([compute_driver_executable()[0], "--version"], capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else f"Playwright's Node does not run: {done.stderr.strip()}"
