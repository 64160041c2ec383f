"""Write files so that a name is always either the old file or the whole new one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def partial_name(path: Path) -> Path:
    """Return the name beside ``path`` under which this process writes it: ``clip.part-123.mp4`` for ``clip.mp4``."""
    return path.with_name(f"{path.stem}.part-{os.getpid()}{path.suffix}")


@contextmanager
def replaced(path: Path, *, check: bool = False) -> Iterator[Path]:
    """Give a name to write to, which takes the place of ``path`` when the block ends well.

    With ``check`` nothing takes its place: it is only tried whether the name can be written. Raises OSError.
    """
    if path.is_dir():
        raise IsADirectoryError(21, os.strerror(21), str(path))
    if path.exists() and not path.is_file():  # a device or a pipe
        yield path
        return
    partial = partial_name(path)
    try:
        if check:
            partial.touch()
        yield partial
        if not check:
            os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
