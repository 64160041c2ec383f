"""Memory and CPU time of a process, from /proc; zeros where there is none."""

from __future__ import annotations

import os
from pathlib import Path


def rss_bytes(pid: int | None) -> int:
    """Resident memory in bytes, what it shares with the fork server included."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


def cpu_s(pid: int | None) -> float:
    """CPU time in seconds, user and system, since the process began."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0
