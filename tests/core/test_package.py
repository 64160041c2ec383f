"""The package itself: what an import costs, what it holds, what it never touches."""

from __future__ import annotations

import ast
import doctest
import gc
import importlib
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import mfcmt_core
from mfcmt_core import MFCMT, MFCMTConfig, workspace

from .helpers import PRESETS

PACKAGE = Path(mfcmt_core.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))


def run(program):
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_is_cheap():
    """The command line and the service's front import the package without numpy, numba and OpenCV."""
    heavy = "{'numpy', 'numba', 'cv2', 'scipy', 'msgpack'} & set(__import__('sys').modules)"
    assert run(f"import mfcmt_core; mfcmt_core.MFCMTError; print({heavy})").strip() == "set()"
    assert run(f"import mfcmt_core; mfcmt_core.MFCMTConfig.paper(); print({heavy})").strip() == "set()"
    assert run(f"import mfcmt_core.cli; print({heavy})").strip() == "set()"


def test_all_public_names_exist():
    for name in mfcmt_core.__all__:
        assert getattr(mfcmt_core, name) is not None
    with pytest.raises(AttributeError, match="nosuch"):
        _ = mfcmt_core.nosuch
    assert (PACKAGE / "py.typed").is_file()


@pytest.mark.parametrize(
    "file",
    [file for file in SOURCES if ">>> " in file.read_text()],
    ids=lambda file: str(file.relative_to(PACKAGE)),
)
def test_examples_in_docstrings_work(file):
    parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
    module = importlib.import_module(".".join(parts).removesuffix(".__init__"))
    results = doctest.testmod(module)
    assert results.attempted > 0
    assert results.failed == 0


def imported(tree):
    """Yield the full name of each module that a file imports absolutely."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module or ""


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_no_service_and_no_pickle(file):
    tree = ast.parse(file.read_text())
    tops = {name.split(".")[0] for name in imported(tree)}
    assert "service" not in tops
    banned = {"pickle", "cPickle", "_pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
    assert not tops & (banned - {"joblib"} if file.name == "batch.py" else banned)  # it runs batches by joblib
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            assert isinstance(node.value, ast.Constant)
            assert node.value.value is False
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"eval", "exec"}


def arrays_of(thing, seen=None):
    """Return every array that is reachable from an object through attributes and containers."""
    seen = {} if seen is None else seen
    if id(thing) in seen or isinstance(thing, str | bytes | int | float | type(None)):
        return seen
    seen[id(thing)] = thing
    if isinstance(thing, dict):
        parts = list(thing.values())
    elif isinstance(thing, list | tuple | set) or type(thing).__name__ == "deque":
        parts = list(thing)
    elif isinstance(thing, np.ndarray):
        parts = [thing.base] if thing.base is not None else []
    else:
        slots = [getattr(thing, name, None) for cls in type(thing).__mro__ for name in getattr(cls, "__slots__", ())]
        parts = [*slots, *getattr(thing, "__dict__", {}).values()]
    for part in parts:
        arrays_of(part, seen)
    return seen


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("box", [(132, 98, 56, 44), (160, 20, 4, 200), (50, 50, 1, 100)])
def test_a_tracker_takes_little_memory(box, preset, frames):
    """It is at most 1.5 MB, without the memory that all trackers of a process share."""
    MFCMT(PRESETS[preset]).init(frames[0], box)
    list(MFCMT(PRESETS[preset]).track(frames[:5], box))  # scratch of these shapes is there
    gc.collect()
    tracemalloc.start()
    tracker = MFCMT(PRESETS[preset])
    tracker.init(frames[0], box)
    for frame in frames[1:5]:
        tracker.update(frame)
    gc.collect()
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 1_500_000
    owned = [a for a in arrays_of(tracker).values() if isinstance(a, np.ndarray) and a.base is None]
    shared = {id(tracker._target.template.features.names)}
    assert sum(a.nbytes for a in owned if id(a) not in shared) < 1_500_000


def test_scratch_does_not_grow_with_the_number_of_shapes(frames):
    def held():
        return sum(memory.nbytes for _, _, memory in workspace._local.buffers.values())

    def follow(size, box):
        tracker = MFCMT(MFCMTConfig.default().replace(lost_after=1, template_threshold=5))
        tracker.init(frames[0][: size[1], : size[0]], box)
        for frame in frames[1:4]:  # lost at once: the whole frame is searched, too
            tracker.update(frame[: size[1], : size[0]])

    follow((320, 240), (50, 50, 100, 100))
    follow((320, 240), (20, 100, 250, 10))
    follow((320, 240), (100, 20, 10, 210))
    before = held()
    for k in range(60):
        follow((260 + k, 180 + k), (40, 40, 20 + 3 * k, 140 - 2 * k))
    assert held() <= 1.2 * before


def test_a_tracker_keeps_no_image(frames, clip):
    tracker = MFCMT()
    tracker.init(frames[0], clip.boxes[0])
    tracker.update(frames[1])
    owned = [a for a in arrays_of(tracker).values() if isinstance(a, np.ndarray)]
    assert not any(np.shares_memory(a, f) for a in owned for f in frames[:2])
