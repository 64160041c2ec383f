"""The memory that this process may use."""

from __future__ import annotations

import os
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup")
MIB = 1024 * 1024
# The memory is divided by this for the bytes under way, within these bounds.
SHARE = 8
LEAST, MOST = 128 * MIB, 512 * MIB


def usable_memory(cgroup: Path = CGROUP) -> int:
    """Return the memory limit in bytes of cgroup version 2 or 1, or the machine's memory if that is less."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        try:
            limit = (cgroup / name).read_text().strip()
        except OSError:
            continue
        return min(machine, int(limit)) if limit.isdigit() else machine
    return machine


def budget_bytes() -> int:
    """Return the default of ``max_upload_bytes``: an eighth of the memory, from 128 to 512 MiB."""
    return max(LEAST, min(MOST, usable_memory() // SHARE))
