"""Scratch arrays that all trackers of a thread share, so that a tracker owns only its models."""

from __future__ import annotations

import threading
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

_local = threading.local()


def scratch(name: str, shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """Return this thread's scratch array called ``name``. Its contents are undefined.

    There is one buffer per name, which grows to the largest shape that was asked for: a process that tracks targets
    of a thousand shapes holds no more memory than one that tracks the largest of them. A name has one dtype.
    """
    try:
        buffers: dict[str, tuple[tuple[int, ...], npt.NDArray[Any], npt.NDArray[Any]]] = _local.buffers
    except AttributeError:
        buffers = _local.buffers = {}
    known = buffers.get(name)
    if known is not None and known[0] == shape:  # one target's shapes are the same in every frame
        return known[1]
    size = prod(shape)
    memory = known[2] if known is not None and known[2].size >= size else np.zeros(size, dtype)
    array = memory[:size].reshape(shape)
    buffers[name] = shape, array, memory
    return array
