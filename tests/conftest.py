"""Shared fixtures: where the real sequences are, and skips that CI does not accept."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# As commands and lanes do, before numpy is loaded: on some processors (AMD's among them) OpenBLAS sums in another order
# with two threads, and boxes differ in the eighth digit.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# What is tested by properties is whether they hold, not how long an example takes: the machine may be busy. In CI the
# examples are the same in each run, so that a change is never refused for an old fault; elsewhere they are new ones.
settings.register_profile(
    "busy",
    settings.default,
    deadline=None,
    derandomize="MFCMT_CI" in os.environ,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("busy")

ROOT = Path(__file__).resolve().parents[1]
OTB_ROOT = Path(os.environ.get("MFCMT_OTB_ROOT", ROOT.parent / "shared" / "data" / "otb"))
# Files and folders of tests by their marker. Slow are many servers and long clips; the rest covers every module.
BROWSER = (
    "browser",
    "core/test_cli_pick.py",
    "service/jsclient/test_apps.py",
    "service/jsclient/test_browser.py",
    "service/jsclient/test_pages.py",
)
CHAOS = ("chaos",)
SLOW = (
    *BROWSER,
    *CHAOS,
    "bridges",
    "clusters",
    "core/otb/test_between.py",
    "core/otb/test_command.py",
    "core/otb/test_published.py",
    "core/otb/test_report.py",
    "core/otb/test_runner.py",
    "core/test_cli_bench.py",
    "core/test_cli_track.py",
    "core/test_cli_track_live.py",
    "core/test_cli_track_many.py",
    "core/test_cli_track_video.py",
    "core/test_cli_warmup.py",
    "core/test_determinism.py",
    "core/test_progress.py",
    "core/video",
    "docker/test_image.py",
    "docker/test_monitoring.py",
    "docker/test_nodes.py",
    "docker/test_proxies.py",
    "examples",
    "project/test_wheel.py",
    "service/cli",
    "service/cluster/test_failover.py",
    "service/cluster/test_nodes.py",
    "service/cluster/test_serve_nodes.py",
    "service/generated",
    "service/jsclient",
    "service/live/test_client_proxies.py",
    "service/live/test_client_rollout.py",
    "service/live/test_faults.py",
    "service/live/test_flow.py",
    "service/live/test_regions.py",
    "service/live/test_restart.py",
    "service/unit/test_tenants.py",
    "service/wire/test_lanes.py",
    "service/wire/test_limits.py",
    "service/wire/test_schemathesis.py",
    "service/wire/test_slow.py",
)


MARKED = {
    marker: [ROOT / "tests" / place for place in places]
    for marker, places in (("slow", SLOW), ("browser", BROWSER), ("chaos", CHAOS))
}


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Return True for slow files where no slow test is wanted: to read them would take longer than many tests."""
    unwanted = "not slow" in config.option.markexpr
    return (unwanted and any(collection_path.is_relative_to(place) for place in MARKED["slow"])) or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests by their place. Where several processes share them, put slow ones first, so that all end together."""
    for item in items:
        for marker, places in MARKED.items():
            if any(item.path.is_relative_to(place) for place in places):
                item.add_marker(marker)
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
