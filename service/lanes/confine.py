"""What a lane gives up before it looks at the first byte of a client: it decodes images that strangers send.

Linux gives the means: a network namespace without devices, no capabilities, no new privileges, Landlock
(no file is written, none is read but the libraries, nothing is executed, no TCP, no signal to and no look into
another process) and resource limits. Each is used where the platform has it and allows it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import stat
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path

MAX_OPEN_FILES = 64
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
PR_SET_NO_NEW_PRIVS = 38
# The same numbers on every architecture since Linux 5.13.
LANDLOCK_CREATE_RULESET, LANDLOCK_ADD_RULE, LANDLOCK_RESTRICT_SELF = 444, 445, 446
LANDLOCK_VERSION, LANDLOCK_PATH_BENEATH = 1, 1
READ_FILE, READ_DIR = 1 << 2, 1 << 3
# Rights over files, TCP and other processes that each version of Landlock knows.
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


def confine() -> list[str]:
    """Give up what can be given up, for this process and for good; what it was."""
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
        if version := _landlock(libc, _libraries()):
            done.append(f"landlock-{version}")
    return done


def _limits() -> list[str]:
    """Few files, no children, no core dump; where the log is not a file, nothing written to any."""
    lowered = {resource.RLIMIT_CORE: 0, resource.RLIMIT_NOFILE: MAX_OPEN_FILES, resource.RLIMIT_NPROC: 0}
    if not any(stat.S_ISREG(os.fstat(descriptor).st_mode) for descriptor in (1, 2)):
        lowered[resource.RLIMIT_FSIZE] = 0
    for limit, most in lowered.items():
        hard = resource.getrlimit(limit)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(limit, (most, most))
    return ["limits"]


def _libraries() -> list[Path]:
    """What may have to be read later: Python's modules, ours, and the system's libraries."""
    told = sysconfig.get_paths()
    ours = Path(__file__).resolve().parents[2]
    folders = [Path(told[name]) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    return [*folders, ours / "service", ours / "mfcmt_core", Path("/usr/lib"), Path("/lib"), Path("/lib64")]


def _landlock(libc: ctypes.CDLL, readable: Iterable[Path]) -> int:
    """Restrict this process; the version of Landlock that does, 0 without one."""
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
