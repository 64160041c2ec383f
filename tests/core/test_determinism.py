"""Same frames, same boxes: in any process, in any thread, beside any other tracker."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from mfcmt_core import MFCMT, MFCMTConfig, synthetic

from .helpers import ALERT, PRESETS, digest

ROOT = Path(__file__).resolve().parents[2]

PROGRAM = """
import hashlib, sys
from mfcmt_core import MFCMT, MFCMTConfig, synthetic
from tests.core.helpers import digest
for preset in ("default", "paper"):
    clip = synthetic.clip("scale")
    tracker = MFCMT(MFCMTConfig.preset(preset))
    results = list(tracker.track(clip.frames[:12], clip.boxes[0]))
    print(digest(results), hashlib.sha256(tracker.to_bytes()).hexdigest())
    if len(sys.argv) > 1:  # a snapshot of this process for the other
        open(sys.argv[1] + preset, "wb").write(tracker.to_bytes())
"""


def run_elsewhere(*args, program=PROGRAM, **environment):
    done = subprocess.run(
        [sys.executable, "-c", program, *args],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    return done.stdout


ONE_TRACKER = """
import hashlib, sys
from numba.core import caching
from mfcmt_core.kernels import _jit
if len(sys.argv) > 1:  # nothing is found and nothing kept
    _jit._Cache = lambda function: caching.NullCache()
from mfcmt_core import MFCMT, synthetic
from tests.core.helpers import digest
clip, tracker = synthetic.clip("motion"), MFCMT()
results = list(tracker.track(clip.frames[:8], clip.boxes[0]))
print(digest(results), hashlib.sha256(tracker.to_bytes()).hexdigest())
"""


def test_a_process_that_compiles_gives_the_bits_of_one_that_loads(tmp_path):
    """One process has an empty cache, one the cache of the first, and one cannot write any."""
    first, second = (run_elsewhere(program=ONE_TRACKER, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2))
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nbi")}
    assert kept
    third = run_elsewhere("without", program=ONE_TRACKER, NUMBA_CACHE_DIR=str(tmp_path))
    assert first == second == third
    assert kept == {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nbi")}


def run_here(preset):
    clip = synthetic.clip("scale")
    tracker = MFCMT(MFCMTConfig.preset(preset))
    return digest(list(tracker.track(clip.frames[:12], clip.boxes[0]))), tracker


def test_another_process_gives_the_same_bits(tmp_path):
    """It has another hash seed, and continues from a snapshot, too."""
    one = run_elsewhere(str(tmp_path) + "/", PYTHONHASHSEED="1")
    two = run_elsewhere(PYTHONHASHSEED="2")
    assert one == two
    clip = synthetic.clip("scale")
    for preset, line in zip(PRESETS, one.splitlines(), strict=True):
        word, tracker = run_here(preset)
        assert line.startswith(word)
        restored = MFCMT.from_bytes((tmp_path / preset).read_bytes())
        assert restored.to_bytes() == tracker.to_bytes()
        for frame in clip.frames[12:16]:
            assert restored.update(frame) == tracker.update(frame)


@pytest.fixture(scope="module")
def jobs():
    """Return targets of several shapes, frame sizes and configurations, each with its results alone."""
    motion, leaves = synthetic.clip("motion"), synthetic.clip("leaves")
    plans = [
        (MFCMTConfig.default(), motion.frames[:25], tuple(motion.boxes[0])),
        (MFCMTConfig.default(), motion.frames[5:30], (40.0, 60.0, 90.0, 30.0)),
        (MFCMTConfig.paper(), motion.frames[:25], tuple(motion.boxes[0])),
        (ALERT, leaves.frames[45:95], tuple(leaves.boxes[45])),
        (MFCMTConfig.default(), [f[:120, :200] for f in motion.frames[:25]], (30.0, 30.0, 20.0, 60.0)),
        (MFCMTConfig.default(), synthetic.clip("grey").frames[:25], tuple(motion.boxes[0])),
    ]
    return [(plan, digest(list(MFCMT(plan[0]).track(*plan[1:])))) for plan in plans]


def test_interleaved_trackers_give_the_same_bits(jobs):
    """Scratch arrays are shared, so no tracker may rely on what another has overwritten."""
    runs = [MFCMT(config).track(frames, box) for (config, frames, box), _ in jobs]
    results = [[] for _ in runs]
    for _ in range(50):
        for run, out in zip(runs, results, strict=True):
            out.extend([r for r in [next(run, None)] if r is not None])
    assert [digest(out) for out in results] == [expected for _, expected in jobs]


def test_trackers_in_many_threads_give_the_same_bits(jobs):
    barrier = Barrier(len(jobs))

    def work(job):
        (config, frames, box), expected = job
        barrier.wait(60)
        return [digest(list(MFCMT(config).track(frames, box))) == expected for _ in range(2)]

    with ThreadPoolExecutor(len(jobs)) as pool:
        assert all(all(same) for same in pool.map(work, jobs))


def test_a_tracker_may_change_its_thread_with_every_frame(jobs):
    (config, frames, box), expected = jobs[0]
    tracker = MFCMT(config)
    results = [tracker.init(frames[0], box)]
    for frame in frames[1:]:
        with ThreadPoolExecutor(1) as pool:
            results.append(pool.submit(tracker.update, frame).result())
    assert digest(results) == expected


def test_maps_of_interleaved_trackers_are_their_own(jobs):
    """The maps are copies, and those of the right tracker."""
    (config, frames, box), _ = jobs[0]
    alone, one, other = (MFCMT(config) for _ in range(3))
    for tracker in (alone, one):
        tracker.init(frames[0], box)
    expected = alone.update(frames[1], maps=True).maps
    other.init(frames[3], (90.0, 70.0, 56.0, 44.0))
    actual = one.update(frames[1], maps=True).maps
    other.update(frames[4])
    assert all((actual[name] == expected[name]).all() for name in expected)
