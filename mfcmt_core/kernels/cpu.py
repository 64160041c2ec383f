"""Which CPU the kernels are compiled for: the one that is asked for, if this machine has its instructions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numba.core.config
from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

_config: Any = numba.core.config

# What the levels of x86-64 add to those below them, as LLVM names it, as far as compiled kernels could use it.
_V2 = frozenset({"cx16", "popcnt", "sahf", "sse3", "ssse3", "sse4.1", "sse4.2"})
_V3 = _V2 | {"avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"}
_V4 = _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
LEVELS = {"x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}


def lacking(cpu: str | None, features: Mapping[str, bool]) -> set[str]:
    """The instructions of a level of x86-64 that are not among ``features``; none for any other name."""
    return {name for name in LEVELS.get(cpu or "", ()) if not features.get(name)}


def fit() -> None:
    """Have numba compile for this machine where ``NUMBA_CPU_NAME`` asks for instructions that it lacks.

    An image brings kernels for the CPU that it was built for. Here they would end the process at the first
    instruction that is not there; so they are left alone, and kernels of this machine's own are made or found.
    """
    if lacking(_config.CPU_NAME, get_host_cpu_features()):
        _config.CPU_NAME = _config.CPU_FEATURES = None


def target() -> str:
    """The name of that CPU."""
    return _config.CPU_NAME or str(get_host_cpu_name())
