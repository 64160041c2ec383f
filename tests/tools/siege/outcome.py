"""The measurements of a siege, and their targets."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any

from service.load.drive import quantile

from .traffic import MIB

# The least that a service gives itself; see docs/security.md.
ROOM_BYTES = 128 * MIB
# What the front keeps of sessions so that they survive a lane; the besieger's, with frames of 8 MiB, need nearly all.
RECOVERY_BYTES = 384 * MIB
# The bound of the front: bytes under way, as much again in copies of them, half as much in freed memory that the C
# library keeps, what is kept of sessions, and a reserve.
BOUND_BYTES = 2 * ROOM_BYTES + ROOM_BYTES // 2 + RECOVERY_BYTES + 64 * MIB
MAX_STALL_S = 0.05
MAX_RATIO = 3.0
# A busy machine delays the neighbour, too: a wait below this misses no target.
UNFELT_S = 0.02


@dataclass(slots=True)
class Waits:
    """Seconds that the neighbour waited for results, and somebody for ``/livez``."""

    results: list[float] = field(default_factory=list)
    probes: list[float] = field(default_factory=list)

    @property
    def p99_s(self) -> float:
        return quantile(self.results, 0.99)

    @property
    def worst_s(self) -> float:
        return max(self.results + self.probes, default=0.0)


@dataclass(slots=True)
class Outcome:
    """The effects of one attack."""

    attack: str
    rounds: list[tuple[Waits, Waits]] = field(default_factory=list)
    stall_s: float = 0.0
    front_bytes: int = 0
    lanes_bytes: int = 0
    front_above_rest_bytes: int = 0
    answers: Counter[str] = field(default_factory=Counter)
    damage: list[str] = field(default_factory=list)

    @property
    def ratio(self) -> float:
        """The neighbour's p99 over the undisturbed one: the median of the rounds, any of which may be disturbed."""
        return statistics.median(besieged.p99_s / calm.p99_s for calm, besieged in self.rounds)

    @property
    def calm(self) -> Waits:
        """The waits of all undisturbed stretches."""
        return _joined(calm for calm, _ in self.rounds)

    @property
    def besieged(self) -> Waits:
        """The waits of all besieged stretches."""
        return _joined(besieged for _, besieged in self.rounds)

    def missed(self) -> list[str]:
        """Return the targets that were missed."""
        missed = list(self.damage)
        if self.stall_s > MAX_STALL_S:
            missed.append(f"the loop was busy for {self.stall_s * 1e3:.0f} ms at a stretch")
        if self.ratio > MAX_RATIO and self.besieged.p99_s > UNFELT_S:
            missed.append(f"the neighbour's p99 grew {self.ratio:.1f} times")
        if self.front_above_rest_bytes > BOUND_BYTES:
            missed.append(f"the front held {self.front_above_rest_bytes / 1e6:.0f} MB more than at rest")
        return missed

    def as_dict(self) -> dict[str, Any]:
        """For JSON; waits as their p99 and worst."""
        waits = {
            f"{name}_{what}_s": getattr(one, f"{what}_s")
            for name, one in (("calm", self.calm), ("besieged", self.besieged))
            for what in ("p99", "worst")
        }
        rest = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "rounds"}
        return rest | waits | {"ratio": self.ratio, "missed": self.missed()}


def _joined(some: Iterable[Waits]) -> Waits:
    joined = Waits()
    for waits in some:
        joined.results += waits.results
        joined.probes += waits.probes
    return joined
