"""``mfcmt warmup``: compile the kernels for this CPU and keep them on disk.

numba keeps compiled kernels beside the source, or in the user's cache folder if the source cannot be written
(``NUMBA_CACHE_DIR`` names another folder). The keys are CPU, source and types: on another CPU or after an update the
kernels are compiled again, and the old entries stay for the CPU that made them. Kernels beside the source are copied
to the cache folder if that is empty.
"""

# mypy: allow-untyped-calls
from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
import simplejpeg
from numba.core import event
from numba.core.dispatcher import Dispatcher

from .. import kernels, synthetic
from ..config import PRESETS, MFCMTConfig
from ..images.excerpt import excerpt
from ..images.mend import mend
from ..kernels.cpu import target
from ..tracker import MFCMT

ALWAYS: dict[str, Any] = dict.fromkeys(("fused_threshold", "template_threshold", "statistical_threshold"), 0.0)
NEVER: dict[str, Any] = dict.fromkeys(ALWAYS, 10.0) | {"lost_after": 1}
HELP = "from mfcmt_core.cli import warmup; warmup.help_out()"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add no arguments."""


def run(_: argparse.Namespace) -> int:
    """Compile the missing kernels; print how long it took and where they are."""
    start = time.perf_counter()
    found = list(dispatchers())
    for dispatcher in found:
        _copy_prebuilt(dispatcher)
    with _Compiling(found):
        exercise()
    seconds = time.perf_counter() - start
    folders = {Path(d.stats.cache_path) for d in found if d.stats.cache_path}
    if not folders:
        print(f"{len(found)} kernels work ({seconds:.1f} s), but nothing is kept: set NUMBA_CACHE_DIR to a folder")
        return 0
    places = ", ".join(sorted(map(str, folders)))
    print(f"{len(found)} kernels are ready for {target()} ({seconds:.1f} s) in {places}")
    return 0


def dispatchers() -> Iterator[Dispatcher]:
    """Yield every kernel of the package."""
    for info in pkgutil.iter_modules(kernels.__path__, kernels.__name__ + "."):
        module = importlib.import_module(info.name)
        yield from (v for v in vars(module).values() if isinstance(v, Dispatcher) and v.__module__ == info.name)


def exercise() -> None:
    """Run every kernel: all presets on color and gray, learning, lost and restored; mend and cut a JPEG."""
    jpeg = simplejpeg.encode_jpeg(np.zeros((8, 8, 3), np.uint8))
    mend(jpeg)
    excerpt(jpeg, (0, 0, 8, 8))
    for gray in (False, True):
        clip = synthetic.clip("motion", size=(96, 72), target=(18, 14), length=4, gray=gray)
        frames = list(clip.frames)
        for preset in PRESETS:
            for changes in (ALWAYS, NEVER):
                tracker = MFCMT(MFCMTConfig.preset(preset).replace(**changes))
                for _ in tracker.track(frames[:3], clip.boxes[0]):
                    pass
                MFCMT.from_bytes(tracker.to_bytes()).update(frames[3])


def help_out() -> None:
    """Compile the kernels of a tracker with colors and scales only: a third of all, for the second process."""
    clip = synthetic.clip("motion", size=(96, 72), target=(18, 14), length=2)
    for _ in MFCMT(MFCMTConfig.default().replace(features=(), **ALWAYS)).track(clip.frames, clip.boxes[0]):
        pass


class _Compiling(event.Listener):
    """Prints how many kernels are ready while they are compiled. A second process compiles some of them."""

    def __init__(self, found: list[Dispatcher]) -> None:
        self._found, self._printed, self._since = found, 0, time.time()
        self._helper: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        event.register("numba:compile", self)
        return self

    def __exit__(self, *_: object) -> None:
        event.unregister("numba:compile", self)
        if self._helper:
            self._helper.wait()
        if self._printed:
            self._print(len(self._found))
            print(end="\n" if sys.stdout.isatty() else "", flush=True)

    def on_start(self, event: event.Event) -> None:
        """Start to print, and start the second process, when the first kernel is missing."""
        if event.data["dispatcher"] not in self._found or self._printed:
            return
        print("compiling the kernels for this CPU, once: up to a minute", flush=True)
        self._print(self._ready())
        if (os.cpu_count() or 1) > 1 and event.data["dispatcher"].stats.cache_path:
            self._helper = subprocess.Popen([sys.executable, "-c", HELP], stdin=subprocess.DEVNULL)  # noqa: S603

    def on_end(self, event: event.Event) -> None:
        """Print the new count."""
        if event.data["dispatcher"] in self._found:
            self._print(self._ready())

    def _ready(self) -> int:
        """Return how many kernels are loaded here or were written to the cache."""
        folders = {Path(d.stats.cache_path) for d in self._found if d.stats.cache_path}
        files = [file for folder in folders for file in folder.glob("*.nbi") if file.stat().st_mtime >= self._since]
        written = {file.name.partition("-")[0] for file in files}
        return sum(bool(d.overloads) or _stem(d) in written for d in self._found)

    def _print(self, ready: int) -> None:
        """Overwrite the last count on a terminal. Elsewhere, print a line for every tenth kernel."""
        text = f"  {ready} of {len(self._found)}"
        if sys.stdout.isatty():
            print(f"\r{text}", end="", flush=True)
        elif ready // 10 > self._printed // 10:
            print(text, flush=True)
        self._printed = max(ready, 1)


def _stem(dispatcher: Dispatcher) -> str:
    """Return what the names of the kernel's cache files begin with."""
    code = dispatcher.py_func.__code__
    return f"{Path(code.co_filename).stem}.{code.co_name}"


def _copy_prebuilt(dispatcher: Dispatcher) -> None:
    """Copy the kernel's files beside its source to its cache folder, if that has none."""
    if not dispatcher.stats.cache_path:
        return
    folder, source = Path(dispatcher.stats.cache_path), Path(dispatcher.py_func.__code__.co_filename)
    files = list((source.parent / "__pycache__").glob(f"{_stem(dispatcher)}-*.nb[ic]"))
    if not any((folder / file.name).exists() for file in files):
        for file in files:
            shutil.copy(file, folder)
