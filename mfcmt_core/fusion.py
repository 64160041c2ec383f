"""Probability maps and their relative-entropy optimum (section III-B, equations 8–10).

Minimising Σ_l KL(P_l ‖ Q) over maps Q of sum 1 with a Lagrange multiplier gives Q = Σ_l P_l / i, the mean;
with weights, the weighted mean. It adapts through the maps alone: a diffuse one lifts every cell alike and
so decides nothing. What the paper leaves open is how a response becomes a probability map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .kernels.fusion import fuse_and_find
from .workspace import scratch

PSR_LEAVE_OUT = 5
"""Cells on each side of the peak that do not count as sidelobe: 11×11 in all."""

_FLOORS = {"clip": 0, "minimum": 1, "raw": 2}


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest place of the fused map: displacement in cells (x, y), height, peak-to-sidelobe ratio.

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
    """Fuse ``responses`` (maps, rows, columns), zero displacement in the middle, into ``fused``.

    ``responses`` are probability maps afterwards. Sizes are odd. float32.
    """
    tops = scratch("tops", responses.shape[:1])
    y, x, height, psr = fuse_and_find(
        responses, weights, _FLOORS[config.probability], config.sharpness, PSR_LEAVE_OUT, tops, fused
    )
    return Peak((x - fused.shape[1] // 2, y - fused.shape[0] // 2), height, psr, tops.tolist())
