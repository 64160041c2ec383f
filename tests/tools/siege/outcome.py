"""What a siege measured, and its targets."""

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
# The stated bound of the front: what is under way, as much again in copies that are being made, half as much that the
# C library keeps of what was freed, and what else grows.
BOUND_BYTES = 2 * ROOM_BYTES + ROOM_BYTES // 2 + 64 * MIB
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
    """What one attack did."""

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
        """The neighbour's p99 over undisturbed: of the rounds' the middle one, as other work may hit any of them."""
        return statistics.median(besieged.p99_s / calm.p99_s for calm, besieged in self.rounds)

    @property
    def calm(self) -> Waits:
        """Of all rounds, undisturbed."""
        return _joined(calm for calm, _ in self.rounds)

    @property
    def besieged(self) -> Waits:
        """Of all rounds, besieged."""
        return _joined(besieged for _, besieged in self.rounds)

    def missed(self) -> list[str]:
        """The targets that were missed."""
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
