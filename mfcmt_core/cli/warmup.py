"""``mfcmt warmup``: compile the kernels for this CPU and keep them on disk.

numba keeps what it compiles beside the source, or, where that cannot be written, in the user's cache folder
(``NUMBA_CACHE_DIR`` names another). It finds it again by CPU, source and types, so on another CPU, or after an
update, this compiles anew and the old entries stay for the CPU that made them. What lies ready beside the
source is copied to a folder that is still empty.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg
from numba.core.dispatcher import Dispatcher

from .. import kernels, synthetic
from ..config import PRESETS, MFCMTConfig
from ..images.mend import mend
from ..kernels.cpu import target
from ..tracker import MFCMT

ALWAYS: dict[str, Any] = dict.fromkeys(("fused_threshold", "template_threshold", "statistical_threshold"), 0.0)
NEVER: dict[str, Any] = dict.fromkeys(ALWAYS, 10.0) | {"lost_after": 1}


def configure(parser: argparse.ArgumentParser) -> None:
    """No arguments."""


def run(_: argparse.Namespace) -> int:
    """Compile what is missing and say how long it took and where it is."""
    start = time.perf_counter()
    found = list(dispatchers())
    for dispatcher in found:
        _copy_prebuilt(dispatcher)
    exercise()
    seconds = time.perf_counter() - start
    compiled = sum(1 for d in found if d.stats.cache_misses)
    folders = {Path(d.stats.cache_path) for d in found if d.stats.cache_path}
    if not folders:
        print(f"{len(found)} kernels work ({seconds:.1f} s), but nothing is kept: set NUMBA_CACHE_DIR to a folder")
        return 0
    done = f"compiled {compiled} of {len(found)}" if compiled else f"{len(found)}"
    ready = "kernels" if compiled else "kernels are ready"
    places = ", ".join(sorted(map(str, folders)))
    print(f"{done} {ready} for {target()} ({seconds:.1f} s) in {places}")
    return 0


def dispatchers() -> Iterator[Dispatcher]:
    """Every kernel of the package."""
    for info in pkgutil.iter_modules(kernels.__path__, kernels.__name__ + "."):
        module = importlib.import_module(info.name)
        yield from (v for v in vars(module).values() if isinstance(v, Dispatcher) and v.__module__ == info.name)


def exercise() -> None:
    """Have a tracker do everything it can: every preset, colour and grey, learning, lost, restored; mend a JPEG."""
    mend(simplejpeg.encode_jpeg(np.zeros((8, 8, 3), np.uint8)))
    for grey in (False, True):
        clip = synthetic.clip("motion", size=(96, 72), target=(18, 14), length=4, grey=grey)
        frames = list(clip.frames)
        for preset in PRESETS:
            for changes in (ALWAYS, NEVER):
                tracker = MFCMT(MFCMTConfig.preset(preset).replace(**changes))
                for _ in tracker.track(frames[:3], clip.boxes[0]):
                    pass
                MFCMT.from_bytes(tracker.to_bytes()).update(frames[3])


def _copy_prebuilt(dispatcher: Dispatcher) -> None:
    """Fill the kernel's cache folder, while it is empty, from the one beside its source."""
    if not dispatcher.stats.cache_path:
        return
    code, folder = dispatcher.py_func.__code__, Path(dispatcher.stats.cache_path)
    source = Path(code.co_filename)
    files = list((source.parent / "__pycache__").glob(f"{source.stem}.{code.co_name}-*.nb[ic]"))
    if not any((folder / file.name).exists() for file in files):
        for file in files:
            shutil.copy(file, folder)
