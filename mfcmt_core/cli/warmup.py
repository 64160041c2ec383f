"""``mfcmt warmup``: compile the kernels for this CPU and keep them on disk.

numba keeps what it compiles beside the source, or, where that cannot be written, in the user's cache folder
(``NUMBA_CACHE_DIR`` names another). It finds it again by CPU, source and types, so on another CPU, or after an
update, this compiles anew and the old entries stay for the CPU that made them. What lies ready beside the
source is copied to a folder that is still empty.
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
from ..images.mend import mend
from ..kernels.cpu import target
from ..tracker import MFCMT

ALWAYS: dict[str, Any] = dict.fromkeys(("fused_threshold", "template_threshold", "statistical_threshold"), 0.0)
NEVER: dict[str, Any] = dict.fromkeys(ALWAYS, 10.0) | {"lost_after": 1}
HELP = "from mfcmt_core.cli import warmup; warmup.help_out()"


def configure(parser: argparse.ArgumentParser) -> None:
    """No arguments."""


def run(_: argparse.Namespace) -> int:
    """Compile what is missing and say how long it took and where it is."""
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
    """Every kernel of the package."""
    for info in pkgutil.iter_modules(kernels.__path__, kernels.__name__ + "."):
        module = importlib.import_module(info.name)
        yield from (v for v in vars(module).values() if isinstance(v, Dispatcher) and v.__module__ == info.name)


def exercise() -> None:
    """Have a tracker do everything it can: every preset, colour and grey, learning, lost, restored; mend a JPEG."""
    mend(simplejpeg.encode_jpeg(np.zeros((8, 8, 3), np.uint8)))
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
    """Compile what a tracker needs that looks at sizes and colours alone: about a third of all."""
    clip = synthetic.clip("motion", size=(96, 72), target=(18, 14), length=2)
    for _ in MFCMT(MFCMTConfig.default().replace(features=(), **ALWAYS)).track(clip.frames, clip.boxes[0]):
        pass


class _Compiling(event.Listener):
    """Tells how many kernels are there while some are compiled, a part of them by a second process."""

    def __init__(self, found: list[Dispatcher]) -> None:
        self._found, self._told, self._since = found, 0, time.time()
        self._helper: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        event.register("numba:compile", self)
        return self

    def __exit__(self, *_: object) -> None:
        event.unregister("numba:compile", self)
        if self._helper:
            self._helper.wait()
        if self._told:
            self._tell(len(self._found))
            print(end="\n" if sys.stdout.isatty() else "", flush=True)

    def on_start(self, event: event.Event) -> None:
        """Begin, when the first kernel turns out to be missing."""
        if event.data["dispatcher"] not in self._found or self._told:
            return
        print("compiling the kernels for this CPU, once: up to a minute", flush=True)
        self._tell(self._ready())
        if (os.cpu_count() or 1) > 1 and event.data["dispatcher"].stats.cache_path:
            self._helper = subprocess.Popen([sys.executable, "-c", HELP], stdin=subprocess.DEVNULL)  # noqa: S603

    def on_end(self, event: event.Event) -> None:
        """Count."""
        if event.data["dispatcher"] in self._found:
            self._tell(self._ready())

    def _ready(self) -> int:
        """How many kernels are loaded here or have been written by now."""
        folders = {Path(d.stats.cache_path) for d in self._found if d.stats.cache_path}
        files = [file for folder in folders for file in folder.glob("*.nbi") if file.stat().st_mtime >= self._since]
        written = {file.name.partition("-")[0] for file in files}
        return sum(bool(d.overloads) or _stem(d) in written for d in self._found)

    def _tell(self, ready: int) -> None:
        """Write over the last count on a terminal; elsewhere a line for every tenth kernel."""
        text = f"  {ready} of {len(self._found)}"
        if sys.stdout.isatty():
            print(f"\r{text}", end="", flush=True)
        elif ready // 10 > self._told // 10:
            print(text, flush=True)
        self._told = max(ready, 1)


def _stem(dispatcher: Dispatcher) -> str:
    """What the names of the kernel's files begin with."""
    code = dispatcher.py_func.__code__
    return f"{Path(code.co_filename).stem}.{code.co_name}"


def _copy_prebuilt(dispatcher: Dispatcher) -> None:
    """Fill the kernel's cache folder, while it is empty, from the one beside its source."""
    if not dispatcher.stats.cache_path:
        return
    folder, source = Path(dispatcher.stats.cache_path), Path(dispatcher.py_func.__code__.co_filename)
    files = list((source.parent / "__pycache__").glob(f"{_stem(dispatcher)}-*.nb[ic]"))
    if not any((folder / file.name).exists() for file in files):
        for file in files:
            shutil.copy(file, folder)
