"""What several tests ask of results."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

import numpy as np

from mfcmt_core import MFCMT, MFCMTConfig, TrackResult
from mfcmt_core.template import TemplateModel

PRESETS = {"default": MFCMTConfig.default(), "paper": MFCMTConfig.paper()}

ALERT = MFCMTConfig.default().replace(usual_threshold=0.3, lost_after=8)
"""Gives a target up soon once it is gone, and remembers what it looked like."""


def assert_sane(result: TrackResult, frame_size: tuple[int, int]) -> None:
    """Assert that a result is finite, has its middle inside the frame, and is consistent."""
    x, y, w, h = result.box
    assert np.isfinite(result.box).all()
    assert w > 0
    assert h > 0
    assert 0 < result.scale < np.inf
    if result.scores is None:  # the first: the box as it was given
        assert result.flags is result.reliable is result.psr is None
        return
    assert -1e-6 <= x + w / 2 <= frame_size[0] + 1e-6
    assert -1e-6 <= y + h / 2 <= frame_size[1] + 1e-6
    assert np.isfinite([result.psr, result.scores.fused, result.scores.template, result.scores.statistical]).all()
    assert result.flags is not None
    assert result.updated or not result.reliable
    assert not result.reliable or (result.flags.fused and result.flags.template and result.flags.statistical)
    assert result.status == "tracking" or not result.reliable
    assert 0 <= result.confidence <= 1
    assert all(type(v) is float for v in (*result.box, result.scale, result.psr))


def filters_of(model: TemplateModel) -> np.ndarray:
    """Return W of equation 2, (channels, n, n // 2 + 1)."""
    return np.concatenate(
        [model.numerator[a:b] * np.conj(g) for (a, b), g in zip(model.blocks, model.quotient, strict=True)]
    )


def track(config: MFCMTConfig, frames: Sequence[np.ndarray], box: Iterable[float]) -> list[TrackResult]:
    """Return the results of all frames, after :func:`assert_sane` on each."""
    height, width = frames[0].shape[:2]
    results = list(MFCMT(config).track(frames, box))
    for result in results:
        assert_sane(result, (width, height))
    return results


def boxes_of(results: Iterable[TrackResult]) -> np.ndarray:
    """(N, 4)"""
    return np.array([r.box for r in results])


def digest(results: Iterable[TrackResult]) -> str:
    """Return a hash of all bits of the results."""
    return hashlib.sha256(repr([(r.box, r.status, r.scores, r.psr, r.scale) for r in results]).encode()).hexdigest()
