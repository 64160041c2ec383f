"""The fit of the confidence: it finds what made the data, and never judges by what it has seen."""

from __future__ import annotations

import numpy as np
import pytest

from mfcmt_core import synthetic
from mfcmt_core.confidence import DEFAULT, WEIGHED
from mfcmt_core.config import MFCMTConfig
from mfcmt_core.otb.dataset import Sequence
from mfcmt_core.otb.fit import Recorded, constants, fit, held_out, record, starts


def made(source, name, seed, weights, frames=4000):
    """A sequence whose frames are right by the odds that ``weights`` and a bias of 1 give."""
    rng = np.random.default_rng(seed)
    signals = rng.normal(size=(frames, len(weights)))
    odds = 1 / (1 + np.exp(-(signals @ weights + 1)))
    overlap = np.where(rng.random(frames) < odds, 0.8, 0.0)
    return Recorded(source, name, signals, overlap, overlap, np.zeros(frames))


def test_it_finds_the_weights_that_made_the_data():
    weights = np.array([1.0, -2.0, 0.0])
    model = fit([made("a", str(k), k, weights) for k in range(3)], ridge=1e-6)
    assert model.weights == pytest.approx(weights, abs=0.15)
    assert model.bias == pytest.approx(1, abs=0.15)


def test_a_sequence_weighs_alike_however_long_it_is():
    same, other = made("a", "x", 1, np.array([2.0])), made("a", "y", 2, np.array([-2.0]))
    longer = Recorded("a", "x", *(np.concatenate([v] * 3) for v in (same.signals, same.overlap)), *[np.zeros(0)] * 2)
    assert fit([longer, other]).weights == pytest.approx(fit([same, other]).weights, abs=1e-6)


def test_a_data_set_is_judged_by_a_fit_without_it():
    """Two data sets that contradict each other: each is judged by the other's rule, the wrong way round."""
    both = [made("a", "x", 1, np.array([3.0])), made("b", "y", 2, np.array([-3.0]))]
    for one, judged in zip(both, held_out(both), strict=True):
        assert judged.name == one.name
        assert judged.confidence[one.overlap > 0.5].mean() < judged.confidence[one.overlap < 0.5].mean()


def test_the_constants_are_code_of_the_module():
    from mfcmt_core.confidence import Model

    recorded = [made("a", str(k), k, np.linspace(-1, 1, len(WEIGHED))) for k in range(2)]
    model = eval(constants(fit(recorded)), {"Model": Model})
    assert list(model.weights) == list(DEFAULT.weights)


def test_runs_start_at_several_frames_and_a_tenth_off(monkeypatch):
    clip = synthetic.clip("motion")
    frames = clip.frames[:60]
    sequence = Sequence.of("clip", [], np.array(clip.boxes[:60], float))
    monkeypatch.setattr(Sequence, "read", lambda _, index: frames[index])
    runs = starts(sequence)
    assert [run.start for run in runs] == [0, 0, 20, 40]
    x, y, w, h = clip.boxes[0]
    assert runs[0].box == (x, y, w, h)
    moved = np.array(runs[1].box) - (x, y, w, h)
    assert 0.02 * min(w, h) < np.abs(moved).max() < 0.25 * max(w, h)
    assert [run.box for run in starts(sequence)] == [run.box for run in runs]
    recorded = record("made", sequence, MFCMTConfig.default())
    assert recorded.signals.shape == (59 + 59 + 39 + 19, len(WEIGHED))
    assert np.isfinite(recorded.signals).all()
    assert (recorded.overlap == recorded.reported).all()
