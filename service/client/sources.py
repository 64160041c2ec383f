"""Reads frames and boxes as users give them, and refuses what is none."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Iterable
from dataclasses import replace
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from .types import Frame, Image

T = TypeVar("T")


async def image_bytes(image: Any, what: str = "a frame") -> bytes:
    """Return the bytes of an encoded image, or of the file that a path names. Raises TypeError, OSError."""
    if isinstance(image, bytes):
        return image
    if isinstance(image, PathLike):
        return await asyncio.to_thread(Path(image).read_bytes)
    wanted = f"{what} is bytes or a Path"
    try:
        view = memoryview(image)
    except TypeError:
        hint = "; a file is Path(...)" if isinstance(image, str) else ""
        raise TypeError(f"{wanted}, not {type(image).__name__}{hint}") from None
    if view.ndim != 1 or view.itemsize != 1:
        raise TypeError(
            f"{wanted}, not the pixels of an image ({type(image).__name__}): "
            "encode it, as cv2.imencode('.jpg', image)[1].tobytes()"
        )
    return view.tobytes()


async def as_frame(frame: Image | Frame) -> Frame:
    """Return a frame whose image is bytes. Raises TypeError, OSError."""
    if not isinstance(frame, Frame):
        return Frame(await image_bytes(frame))
    data = await image_bytes(frame.data)
    return frame if data is frame.data else replace(frame, data=data)


def numbers(box: Iterable[float]) -> list[float]:
    """Return a box as ``[x, y, w, h]``. Raises ValueError for anything but four numbers."""
    try:
        values = [] if isinstance(box, str | bytes) else [float(v) for v in box]
    except (TypeError, ValueError):
        values = []
    if len(values) != 4:
        raise ValueError(f"a box is four numbers, (x, y, w, h), not {box!r}")
    return values


async def each(frames: AsyncIterable[T] | Iterable[T]) -> AsyncIterator[T]:
    """Yield the frames one by one; a lazy synchronous source is read in a thread, since it may wait for a camera."""
    if isinstance(frames, AsyncIterable):
        async for frame in frames:
            yield frame
    elif isinstance(frames, list | tuple):
        for frame in frames:
            yield frame
    else:
        source = iter(frames)
        while batch := await asyncio.to_thread(lambda: list(islice(source, 1))):
            yield batch[0]
