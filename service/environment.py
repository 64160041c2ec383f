"""Environment variables with secrets: read once, then removed, so that no child process inherits them."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Collection, Mapping

_taken: dict[str, str] = {}


def take(names: Collection[str]) -> None:
    """Remove variables from the environment of this process; :func:`taken` still returns them.

    They are removed from ``os.environ``, from the C library's copy, and from the block that the kernel shows as
    ``/proc/PID/environ``. ``names`` are in upper case; the names of the variables may be in any case.
    """
    for name in [name for name in os.environ if name.upper() in names]:
        _taken[name] = os.environ[name]
        _overwrite(name)
        del os.environ[name]


def taken() -> Mapping[str, str]:
    """Return the variables that were removed, with names in lower case."""
    return {name.lower(): value for name, value in _taken.items()}


def _overwrite(name: str) -> None:
    """Overwrite the value with zeros: removed variables stay in memory, which a fork inherits."""
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    libc.getenv.restype = ctypes.c_void_p
    if at := libc.getenv(os.fsencode(name)):
        ctypes.memset(at, 0, len(os.fsencode(os.environ[name])))
