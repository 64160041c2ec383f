"""Rights that a lane gives up before it reads the first byte of a client, because it decodes images from strangers.

On Linux these are: a network namespace without devices, no capabilities, no new privileges, resource limits, and
Landlock (the process writes no file, reads none but libraries, executes nothing, opens no TCP connection, and can
neither signal nor inspect another process). Each is used where the platform has it and allows it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import stat
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path

MAX_OPEN_FILES = 64
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS = 1, 38
# The same numbers on every architecture since Linux 5.13.
LANDLOCK_CREATE_RULESET, LANDLOCK_ADD_RULE, LANDLOCK_RESTRICT_SELF = 444, 445, 446
LANDLOCK_VERSION, LANDLOCK_PATH_BENEATH = 1, 1
READ_FILE, READ_DIR = 1 << 2, 1 << 3
# The rights over files, TCP and other processes that each version of Landlock can take away.
FILES = {1: 0x1FFF, 2: 0x3FFF, 3: 0x7FFF, 5: 0xFFFF}
TCP, TCP_SINCE = 0b11, 4
SCOPES, SCOPES_SINCE = 0b11, 6
CAPABILITY_VERSION_3 = 0x20080522


class _Ruleset(ctypes.Structure):
    _fields_ = [("files", ctypes.c_uint64), ("tcp", ctypes.c_uint64), ("scopes", ctypes.c_uint64)]


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = [("files", ctypes.c_uint64), ("folder", ctypes.c_int32)]


class _Capabilities(ctypes.Structure):
    _fields_ = [("version", ctypes.c_uint32), ("pid", ctypes.c_int)]


def die_with_parent() -> None:
    """Have the kernel kill this process when the thread that forked it ends; on Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def confine(readable: Iterable[Path] = ()) -> list[str]:
    """Give up for good every right that this process can give up, and return the names of those it did.

    Files can still be read in the folders of libraries and in those of ``readable``.
    """
    if sys.platform != "linux":
        return _limits()
    libc = ctypes.CDLL(None, use_errno=True)
    done = []
    if libc.unshare(CLONE_NEWNET) == 0 or libc.unshare(CLONE_NEWUSER | CLONE_NEWNET) == 0:
        done.append("no-network")
    done += _limits()
    if libc.capset(ctypes.byref(_Capabilities(CAPABILITY_VERSION_3, 0)), (ctypes.c_uint32 * 6)()) == 0:
        done.append("no-capabilities")
    if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0:
        done.append("no-new-privileges")
        if version := _landlock(libc, [*_libraries(), *readable]):
            done.append(f"landlock-{version}")
    return done


def _limits() -> list[str]:
    """Allow few open files, no children and no core dump; and no writing to files, unless the log is one."""
    lowered = {resource.RLIMIT_CORE: 0, resource.RLIMIT_NOFILE: MAX_OPEN_FILES, resource.RLIMIT_NPROC: 0}
    if not any(stat.S_ISREG(os.fstat(descriptor).st_mode) for descriptor in (1, 2)):
        lowered[resource.RLIMIT_FSIZE] = 0
    for limit, most in lowered.items():
        hard = resource.getrlimit(limit)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(limit, (most, most))
    return ["limits"]


def _libraries() -> list[Path]:
    """Return the folders that may have to be read later: Python's modules, ours, and the system's libraries."""
    paths = sysconfig.get_paths()
    ours = Path(__file__).resolve().parents[2]
    folders = [Path(paths[name]) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    return [*folders, ours / "service", ours / "mfcmt_core", Path("/usr/lib"), Path("/lib"), Path("/lib64")]


def _landlock(libc: ctypes.CDLL, readable: Iterable[Path]) -> int:
    """Restrict this process by Landlock, and return the version of it that does so; 0 if there is none."""
    version: int = libc.syscall(LANDLOCK_CREATE_RULESET, None, ctypes.c_size_t(0), LANDLOCK_VERSION)
    if version < 1:
        return 0
    files = FILES[max(known for known in FILES if known <= version)]
    ruleset = _Ruleset(files, TCP if version >= TCP_SINCE else 0, SCOPES if version >= SCOPES_SINCE else 0)
    size = 24 if version >= SCOPES_SINCE else 16 if version >= TCP_SINCE else 8
    rules = libc.syscall(LANDLOCK_CREATE_RULESET, ctypes.byref(ruleset), ctypes.c_size_t(size), 0)
    if rules < 0:
        return 0
    try:
        for folder in readable:
            with contextlib.suppress(OSError):
                opened = os.open(folder, os.O_PATH | os.O_CLOEXEC)
                rule = _Beneath(READ_FILE | READ_DIR, opened)
                libc.syscall(LANDLOCK_ADD_RULE, rules, LANDLOCK_PATH_BENEATH, ctypes.byref(rule), 0)
                os.close(opened)
        return version if libc.syscall(LANDLOCK_RESTRICT_SELF, rules, 0) == 0 else 0
    finally:
        os.close(rules)
