"""Scratch arrays that the trackers of one thread share, so that a tracker owns only its models."""

from __future__ import annotations

import threading
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

_local = threading.local()


def scratch(name: str, shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """An array of that shape in the memory of that name; its contents are whatever the last user left there.

    One buffer a name grows to the largest shape asked for, so that a process that has seen targets and frames
    of a thousand shapes holds no more than one that saw the largest. A name has one dtype.
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
