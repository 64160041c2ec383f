"""How much memory this process may use."""

from __future__ import annotations

import os
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup")
MIB = 1024 * 1024
# A share of the memory for what is under way, within these bounds.
SHARE = 8
LEAST, MOST = 128 * MIB, 512 * MIB


def usable_memory(cgroup: Path = CGROUP) -> int:
    """Bytes by the limit of cgroup version 2 or 1, at most those of the machine."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        try:
            told = (cgroup / name).read_text().strip()
        except OSError:
            continue
        return min(machine, int(told)) if told.isdigit() else machine
    return machine


def room_bytes() -> int:
    """What may be under way at once where no setting says so: an eighth of the memory, from 128 to 512 MiB."""
    return max(LEAST, min(MOST, usable_memory() // SHARE))
