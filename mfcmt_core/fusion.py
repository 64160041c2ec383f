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
from .kernels.fusion import find_peak, fuse_maps

PSR_LEAVE_OUT = 5
"""Cells on each side of the peak that do not count as sidelobe: 11×11 in all."""

_FLOORS = {"clip": 0, "minimum": 1, "raw": 2}


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest place of the fused map: displacement in cells (x, y), height, peak-to-sidelobe ratio."""

    displacement: tuple[float, float]
    height: float
    psr: float


def fuse(
    responses: npt.NDArray[np.float32],
    weights: npt.NDArray[np.float32],
    config: MFCMTConfig,
    fused: npt.NDArray[np.float32],
) -> Peak:
    """Fuse ``responses`` (maps, rows, columns), zero displacement in the middle, into ``fused``.

    ``responses`` are probability maps afterwards. Sizes are odd. float32.
    """
    fuse_maps(responses, weights, _FLOORS[config.probability], config.sharpness, fused)
    y, x, height, psr = find_peak(fused, PSR_LEAVE_OUT)
    return Peak((x - fused.shape[1] // 2, y - fused.shape[0] // 2), float(height), float(psr))
