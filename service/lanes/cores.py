"""The number of cores that this process may use, and the number of lanes that suits them."""

from __future__ import annotations

import os
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup")


def usable_cores(cgroup: Path = CGROUP) -> int:
    """Return the cores that CPU affinity and the quota of cgroup version 2 or 1 allow, rounded down, at least 1."""
    cores = float(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    quota = _quota(cgroup)
    return max(1, int(cores if quota is None else min(cores, quota)))


def lanes_for(cores: int) -> int:
    """Return one lane fewer than cores: the front fills a core before so many lanes fill theirs.

    One or two cores get one or two lanes; for so few lanes the front needs a fifth of a core, not a whole one.
    """
    return cores - 1 if cores > 2 else cores


def default_lanes() -> int:
    """Return the number of lanes for the cores that this process may use."""
    return lanes_for(usable_cores())


def _quota(cgroup: Path) -> float | None:
    try:
        quota, period = (cgroup / "cpu.max").read_text().split()
    except (OSError, ValueError):
        try:
            quota = (cgroup / "cpu" / "cpu.cfs_quota_us").read_text().strip()
            period = (cgroup / "cpu" / "cpu.cfs_period_us").read_text().strip()
        except OSError:
            return None
    if not quota.isdigit() or not period.isdigit() or period == "0":
        return None
    return int(quota) / int(period)
