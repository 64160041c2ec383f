"""The growth of memory with work: a slope after the warm-up, and its noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

# CPython allocates memory in arenas of 1 MiB; growth below one arena cannot be detected.
STEP_BYTES = 1024 * 1024
# A line through one step rises by at most this multiple of the step, if the step is in the middle.
STEP_SLOPE = 1.5
# The share of the run in which memory settles: caches, tombstones and trajectories fill up to their bounds.
WARM_UP = 0.3
# A slope this many standard errors from 0 is no accident.
ERRORS = 2.0


@dataclass(frozen=True, slots=True)
class Slope:
    """Bytes a unit of work, and the bytes a unit that noise alone may show; ``first`` and ``last`` in bytes."""

    per_unit: float
    noise: float
    first: float
    last: float

    @property
    def flat(self) -> bool:
        """True if no growth can be detected."""
        return self.per_unit <= self.noise


def slope(done: Sequence[float], used: Sequence[float]) -> Slope:
    """The least-squares line through ``used`` bytes after ``done`` units, without the first WARM_UP of them.

    What is left over from a line is correlated from one sample to the next, so that the standard error is
    widened by the correlation at lag 1 (Santer et al. 2000). Needs 8 samples after warm-up.
    """
    samples = [(x, y) for x, y in zip(done, used, strict=True) if x >= WARM_UP * done[-1]]
    xs, ys = [x for x, _ in samples], [y for _, y in samples]
    count = len(samples)
    if count < 8:
        raise ValueError(f"{count} samples are too few")
    mean_x, mean_y = sum(xs) / count, sum(ys) / count
    spread = sum((x - mean_x) ** 2 for x in xs)
    per_unit = sum((x - mean_x) * (y - mean_y) for x, y in samples) / spread
    rest = [y - mean_y - per_unit * (x - mean_x) for x, y in samples]
    squares = sum(r * r for r in rest)
    lag = sum(a * b for a, b in pairwise(rest)) / squares if squares else 0.0
    lag = min(max(lag, 0.0), 0.9)
    independent = max(3.0, count * (1 - lag) / (1 + lag))
    error = math.sqrt(squares / (independent - 2) / spread)
    noise = ERRORS * error + STEP_SLOPE * STEP_BYTES / (xs[-1] - xs[0])
    first, last = (mean_y + per_unit * (x - mean_x) for x in (xs[0], xs[-1]))
    return Slope(per_unit, noise, first, last)
