"""Our scores against those of the got10k toolkit, which treats invalid annotations otherwise."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mfcmt_core.otb import Dataset, read_result, score_runs
from mfcmt_core.otb.dataset import ONE_BASED
from mfcmt_core.otb.protocol import ope
from tests.conftest import require

INVALID = {"Biker", "Board", "Twinnings", "Crowds"}


@pytest.fixture(scope="module")
def got10k() -> Any:
    try:
        return import_module("got10k.utils.metrics")
    except ModuleNotFoundError as missing:
        require(False, f"needs {missing.name} (pip install got10k six)")


@pytest.mark.parametrize("tracker", ["MCCT-H", "Struck", "DSST"])
def test_curves_equal_those_of_got10k(got10k: Any, otb2015: Dataset, published: Path, tracker: str) -> None:
    names = [n for n in otb2015.sequences if n not in INVALID and (published / tracker / f"{n}.txt").is_file()]
    assert len(names) >= 95
    ours, theirs = [], []
    for name in names:
        sequence = otb2015[name]
        boxes = read_result(published / tracker / f"{name}.txt", sequence)
        score = score_runs(sequence, [(ope(sequence)[0], boxes)])
        boxes, truth = boxes + ONE_BASED, sequence.boxes + ONE_BASED
        boxes[0] = truth[0]
        success = (got10k.rect_iou(boxes, truth)[:, None] > np.linspace(0, 1, 21)).mean(axis=0)
        precision = (got10k.center_error(boxes, truth)[:, None] <= np.arange(51)).mean(axis=0)
        # a frame on the very edge of a threshold may fall on either side
        assert np.abs(score.success_curve - success).max() <= 1 / len(sequence), name
        assert np.abs(score.precision_curve - precision).max() <= 1 / len(sequence), name
        ours.append((score.success, score.precision))
        theirs.append((success.mean(), precision[20]))
    assert np.mean(ours, axis=0) == pytest.approx(np.mean(theirs, axis=0), abs=1e-4)
