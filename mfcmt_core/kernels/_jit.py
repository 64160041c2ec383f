"""One place that says how kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numba
from numba.core.compiler import Compiler


class _Distinct(Compiler):
    """Arrays handed to one kernel never overlap: LLVM may vectorise loops over many of them without tests."""

    def __init__(self, typing, target, library, args, return_type, flags, locals_):  # type: ignore[no-untyped-def]
        flags.noalias = True
        super().__init__(  # type: ignore[no-untyped-call]
            typing, target, library, args, return_type, flags, locals_
        )


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile for this CPU on first call, without the GIL, and keep the result on disk.

    ``fastmath`` lets sums be vectorised; inputs are finite by construction.
    """
    compile_ = partial(numba.njit, fastmath=True, nogil=True, error_model="numpy", pipeline_class=_Distinct)
    try:
        return compile_(cache=True)(function)
    except RuntimeError:  # no writable place for the cache at all: compile in memory
        return compile_()(function)
