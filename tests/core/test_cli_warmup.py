"""``mfcmt warmup``: afterwards nothing is compiled any more, wherever the cache lies."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba.core.caching
import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features

from mfcmt_core.cli import warmup
from mfcmt_core.kernels import cpu
from mfcmt_core.kernels._jit import kernel

SCRIPT = Path(sys.executable).with_name("mfcmt")

TRACK = """
import sys
from mfcmt_core import MFCMT, synthetic
from mfcmt_core.cli import warmup
for name in sys.argv[1:] or synthetic.SCENES:
    clip = synthetic.clip(name, length=24)
    for i, result in enumerate(MFCMT().track(clip.frames, clip.boxes[0])):
        if name == "large" and i == 3:
            break
strided = synthetic.clip("motion").frames[0][::2, ::2]
list(MFCMT().track([strided, strided[::-1]], (60, 45, 30, 20)))
print(sum(len(d.stats.cache_misses) for d in warmup.dispatchers()))
print(sum(len(d.stats.cache_hits) for d in warmup.dispatchers()))
"""

ONE_KERNEL = """
import numpy as np
from mfcmt_core.kernels.cells import gray_cells as k
k(np.zeros((8, 8), np.uint8), np.ones((2, 2), np.float32), 0, np.ones((2, 1, 2), np.float32))
print(len(k.stats.cache_misses), len(k.stats.cache_hits))
"""

TARGET = """
from mfcmt_core.kernels.cpu import target
print(target())
"""


def run(*words: object, **changes: str) -> str:
    done = subprocess.run(
        list(map(str, words)),
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"} | changes,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_after_warmup_nothing_is_compiled():
    run(SCRIPT, "warmup")
    said = run(SCRIPT, "warmup")
    assert f"{len(list(warmup.dispatchers()))} kernels are ready" in said
    assert len(said.splitlines()) == 1
    misses, hits = map(int, run(sys.executable, "-c", TRACK).split())
    assert misses == 0
    assert hits >= 10


def test_the_second_process_compiles_kernels_that_a_tracker_needs():
    """The first process finds them ready, and has compiled everything else meanwhile."""
    run(SCRIPT, "warmup")
    code = "from mfcmt_core.cli import warmup; warmup.help_out(); found = list(warmup.dispatchers())\n"
    code += "print(sum(len(d.stats.cache_misses) for d in found), sum(bool(d.overloads) for d in found))"
    misses, used = map(int, run(sys.executable, "-c", code).split())
    assert misses == 0
    assert used > 5


def test_kernels_are_counted_while_they_are_compiled(monkeypatch, capsys):
    monkeypatch.setattr(numba.core.caching.CacheImpl, "_locator_classes", [])
    found = [kernel(lambda x: x + x) for _ in range(10)]
    with warmup._Compiling(found):
        for one in found:
            one(np.float32(2))
    said = capsys.readouterr().out.splitlines()
    assert [said[0].split(",")[0], *said[1:]] == ["compiling the kernels for this CPU", "  10 of 10"]
    with warmup._Compiling(found):
        found[0](np.float32(2))
    assert capsys.readouterr().out == ""


def test_prebuilt_kernels_are_copied_to_the_writable_cache(tmp_path):
    run(SCRIPT, "warmup")
    said = run(SCRIPT, "warmup", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert "kernels are ready" in said
    assert str(tmp_path) in said
    tracked = run(sys.executable, "-c", TRACK, "motion", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert tracked.split()[0] == "0"


def test_another_cpu_compiles_its_own_beside_the_others(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert run(sys.executable, "-c", ONE_KERNEL, **cache) == "1 0\n"
    assert run(sys.executable, "-c", ONE_KERNEL, NUMBA_CPU_NAME="generic", **cache) == "1 0\n"
    for target in ({}, {"NUMBA_CPU_NAME": "generic"}):
        assert run(sys.executable, "-c", ONE_KERNEL, **target, **cache) == "0 1\n"


def test_kernels_work_without_a_writable_cache(monkeypatch):
    monkeypatch.setattr(numba.core.caching.CacheImpl, "_locator_classes", [])
    double = kernel(lambda x: x + x)
    assert double(np.float32(2)) == 4
    assert double.stats.cache_path is None


def test_kernels_for_a_cpu_with_more_instructions_are_not_used() -> None:
    have = get_host_cpu_features()
    beyond = [level for level in cpu.LEVELS if cpu.lacking(level, have)]
    if not beyond:  # no machine of CI can be told to lack some
        pytest.skip("this CPU has all the instructions that there are to lack")
    for level in beyond:
        # where they were used, the process would end by SIGILL
        printed = run(sys.executable, "-c", ONE_KERNEL + TARGET, NUMBA_CPU_NAME=level, NUMBA_CPU_FEATURES="")
        assert printed.split()[-1] != level


def test_a_level_fits_if_all_its_instructions_are_there() -> None:
    everything = dict.fromkeys(cpu.LEVELS["x86-64-v4"], True)
    assert [cpu.lacking(level, everything) for level in cpu.LEVELS] == [set()] * 3
    haswell = everything | dict.fromkeys(cpu.LEVELS["x86-64-v4"] - cpu.LEVELS["x86-64-v3"], False)
    assert cpu.lacking("x86-64-v3", haswell) == set()
    assert cpu.lacking("x86-64-v4", haswell)
    assert cpu.lacking("x86-64-v3", everything | {"avx2": False}) == {"avx2"}
    # no other name says what it needs
    assert cpu.lacking("generic", {}) == cpu.lacking(None, {}) == set()
