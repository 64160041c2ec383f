"""Choose the CPU that the kernels are compiled for: the requested one if this machine has its instructions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numba.core.config
from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

_config: Any = numba.core.config

# The features of the levels of x86-64 that compiled kernels could use, by LLVM's names.
_V2 = frozenset({"cx16", "popcnt", "sahf", "sse3", "ssse3", "sse4.1", "sse4.2"})
_V3 = _V2 | {"avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"}
_V4 = _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
LEVELS = {"x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}


def lacking(cpu: str | None, features: Mapping[str, bool]) -> set[str]:
    """Return the features of an x86-64 level that are missing from ``features``; nothing for any other CPU name."""
    return {name for name in LEVELS.get(cpu or "", ()) if not features.get(name)}


def fit() -> None:
    """Have numba compile for this machine if it lacks instructions that ``NUMBA_CPU_NAME`` asks for.

    A container image holds kernels for the CPU that it was built for. An instruction that is missing here would end
    the process, so those kernels are ignored and kernels for this machine are compiled or found.
    """
    if lacking(_config.CPU_NAME, get_host_cpu_features()):
        _config.CPU_NAME = _config.CPU_FEATURES = None


def target() -> str:
    """Return the name of the CPU that kernels are compiled for."""
    return _config.CPU_NAME or str(get_host_cpu_name())
