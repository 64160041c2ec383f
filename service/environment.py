"""The variables that the service is set up with: read once, and inherited by no process that it starts."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Collection, Mapping

_taken: dict[str, str] = {}


def take(names: Collection[str]) -> None:
    """Take variables out of the environment of this process for good; :func:`taken` still knows them.

    They leave ``os.environ``, the C library's copy, and the block that the kernel shows as ``/proc/PID/environ``.
    ``names`` are in upper case; the variables may be in any.
    """
    for name in [name for name in os.environ if name.upper() in names]:
        _taken[name] = os.environ[name]
        _overwrite(name)
        del os.environ[name]


def taken() -> Mapping[str, str]:
    """The variables that were taken, in lower case, as they were."""
    return {name.lower(): value for name, value in _taken.items()}


def _overwrite(name: str) -> None:
    """Put zeros over the value where it lies: removed variables stay in memory, and a fork inherits that."""
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    libc.getenv.restype = ctypes.c_void_p
    if at := libc.getenv(os.fsencode(name)):
        ctypes.memset(at, 0, len(os.fsencode(os.environ[name])))
