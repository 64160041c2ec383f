"""Fuse probability maps to their relative-entropy optimum (section III-B, equations 8–10).

Minimizing Σ_l KL(P_l ‖ Q) over the maps Q of sum 1, with a Lagrange multiplier, gives the mean Q = Σ_l P_l / i, or with
weights the weighted mean. The fusion adapts through the maps alone: a diffuse map lifts every cell alike and so
decides nothing. The paper leaves open how a response becomes a probability map; ``config.probability`` decides it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .kernels.fusion import fuse_and_find
from .workspace import scratch

PSR_LEAVE_OUT = 5
"""Cells on each side of the peak that do not count as sidelobe: 11×11 in all (Bolme et al., CVPR 2010)."""

_FLOORS = {"clip": 0, "minimum": 1, "raw": 2}


@dataclass(frozen=True, slots=True)
class Peak:
    """The peak of a fused map: its displacement (x, y) in cells, its height, and its peak-to-sidelobe ratio.

    ``tops`` are the highest values of the single responses.
    """

    displacement: tuple[float, float]
    height: float
    psr: float
    tops: list[float]


def fuse(
    responses: npt.NDArray[np.float32],
    weights: npt.NDArray[np.float32],
    config: MFCMTConfig,
    fused: npt.NDArray[np.float32],
) -> Peak:
    """Fuse response maps and return the peak of the fused map.

    Parameters
    ----------
    responses : ndarray of float32, shape (maps, rows, columns)
        The responses, with zero displacement in the middle and odd sizes. They become probability maps in place.
    weights : ndarray of float32, shape (maps,)
        The weight of each map.
    config : MFCMTConfig
        ``probability`` and ``sharpness`` say how a response becomes a probability map.
    fused : ndarray of float32, shape (rows, columns)
        Receives the fused map.

    Returns
    -------
    Peak

    References
    ----------
    D. S. Bolme, J. R. Beveridge, B. A. Draper and Y. M. Lui, "Visual Object Tracking using Adaptive Correlation
    Filters", CVPR 2010, doi:10.1109/CVPR.2010.5539960: the peak-to-sidelobe ratio.
    """
    tops = scratch("tops", responses.shape[:1])
    y, x, height, psr = fuse_and_find(
        responses, weights, _FLOORS[config.probability], config.sharpness, PSR_LEAVE_OUT, tops, fused
    )
    return Peak((x - fused.shape[1] // 2, y - fused.shape[0] // 2), height, psr, tops.tolist())
