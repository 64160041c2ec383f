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


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what takes long; where several processes share the tests, put it first, so that they end together."""
    slow = [ROOT / "tests" / place for place in SLOW]
    for item in items:
        if any(item.path.is_relative_to(place) for place in slow):
            item.add_marker("slow")
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return the number of test processes for ``-n auto``: one for each core that may be used, at most four.

    Each of them has servers of its own, and the longest file bounds what more could gain.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(4, cores)


def require(condition: object, reason: str) -> None:
    """Skip with the reason where something is absent; fail where MFCMT_CI says that it must be there."""
    if not condition:
        (pytest.fail if os.environ.get("MFCMT_CI") else pytest.skip)(reason)


@pytest.fixture(scope="session")
def otb_root() -> Path:
    """The folder of real OTB sequences."""
    require(OTB_ROOT.is_dir(), f"no OTB sequences at {OTB_ROOT} (set MFCMT_OTB_ROOT)")
    return OTB_ROOT
