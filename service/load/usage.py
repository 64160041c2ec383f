"""CPU time and memory of a server's processes, from /proc."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..lanes.usage import cpu_s, rss_bytes

MB = 1e6


@dataclass(frozen=True, slots=True)
class Usage:
    """The CPU time and memory of a process. ``private_bytes`` excludes memory shared with other processes."""

    cpu_s: float
    rss_bytes: int
    private_bytes: int


def usage(pid: int) -> Usage:
    """Return what the process uses now; zeros without /proc."""
    return Usage(cpu_s(pid), rss_bytes(pid), _private_bytes(pid))


def server_processes(front: int) -> dict[str, int]:
    """Return process ids by role: ``front``, ``fork server`` and ``lane 0`` …, in the order of their start."""
    parents = _parents()
    roles = {"front": front}
    forkserver = next((pid for pid, parent in parents.items() if parent == front and _forks(pid)), None)
    if forkserver is not None:
        roles["fork server"] = forkserver
        lanes = sorted(pid for pid, parent in parents.items() if parent == forkserver)
        roles |= {f"lane {number}": pid for number, pid in enumerate(lanes)}
    return roles


def server_usage(front: int) -> dict[str, Usage]:
    """Return what each process of the server uses now, by role."""
    return {role: usage(pid) for role, pid in server_processes(front).items()}


def cpu_between(before: Mapping[str, Usage], after: Mapping[str, Usage]) -> dict[str, float]:
    """Return the CPU seconds of the front and of all lanes together between two readings."""
    spent = {role: now.cpu_s - before[role].cpu_s for role, now in after.items() if role in before}
    lanes = sum(cpu for role, cpu in spent.items() if role.startswith("lane"))
    return {"front": sum(spent.values()) - lanes, "lanes": lanes}


def _parents() -> dict[int, int]:
    parents = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(entry.parent.name)] = int(entry.read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError, ValueError):  # it has just ended
            continue
    return parents


def _forks(pid: int) -> bool:
    try:
        return b"forkserver" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def _private_bytes(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("Private_"))
