"""Memory and CPU time of a process, read from /proc; zeros on systems without it."""

from __future__ import annotations

import os
from pathlib import Path


def rss_bytes(pid: int | None) -> int:
    """Return the resident memory in bytes, including what the process shares with the fork server."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


def cpu_s(pid: int | None) -> float:
    """Return the CPU time in seconds, user and system, since the process began."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0
