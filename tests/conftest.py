"""Shared fixtures: where the real sequences are, and skips that CI does not accept."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# As commands and lanes do, before numpy is loaded: on some processors (AMD's among them) OpenBLAS sums in another order
# with two threads, and boxes differ in the eighth digit.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

ROOT = Path(__file__).resolve().parents[1]
OTB_ROOT = Path(os.environ.get("MFCMT_OTB_ROOT", ROOT.parent / "shared" / "data" / "otb"))
# Where tests take long: real browsers, many servers, long clips. The rest touches every part of the project.
SLOW = (
    "browser",
    "chaos",
    "core/otb",
    "core/test_cli_bench.py",
    "core/test_cli_track.py",
    "core/test_cli_warmup.py",
    "docker/test_image.py",
    "docker/test_monitoring.py",
    "docker/test_proxies.py",
    "examples",
    "service/cli",
    "service/jsclient",
    "service/live/test_faults.py",
    "service/live/test_flow.py",
    "service/live/test_regions.py",
    "service/live/test_restart.py",
    "service/wire/test_lanes.py",
    "service/wire/test_limits.py",
    "service/wire/test_schemathesis.py",
    "service/wire/test_slow.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what takes long."""
    slow = [ROOT / "tests" / place for place in SLOW]
    for item in items:
        if any(item.path.is_relative_to(place) for place in slow):
            item.add_marker("slow")


def require(condition: object, reason: str) -> None:
    """Skip with the reason where something is absent; fail where MFCMT_CI says that it must be there."""
    if not condition:
        (pytest.fail if os.environ.get("MFCMT_CI") else pytest.skip)(reason)


@pytest.fixture(scope="session")
def otb_root() -> Path:
    """The folder of real OTB sequences."""
    require(OTB_ROOT.is_dir(), f"no OTB sequences at {OTB_ROOT} (set MFCMT_OTB_ROOT)")
    return OTB_ROOT
