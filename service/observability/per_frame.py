"""A counter and a histogram that are cheap to count with, for what is counted of every frame.

Those of prometheus_client take a lock for each count, and look up labels under another: 9 µs for one frame, and these
take 3. They are counted by one thread alone, the event loop's.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import accumulate

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, Exemplar, HistogramMetricFamily
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString


class FrameCounter(Collector):
    """A counter, with a label whose values are ``known`` or with none. ``counts`` are added to, by value or ``""``."""

    def __init__(
        self, name: str, text: str, registry: CollectorRegistry, label: str = "", known: Iterable[str] = ("",)
    ) -> None:
        self.counts: Counter[str] = Counter(dict.fromkeys(known, 0))
        self._name, self._text, self._labels = name, text, [label] if label else []
        registry.register(self)

    def collect(self) -> Iterable[CounterMetricFamily]:
        """Return what was counted, for the registry."""
        family = CounterMetricFamily(self._name, self._text, labels=self._labels)
        for value, count in self.counts.items():
            family.add_metric([value] if self._labels else [], count)
        yield family


class FrameHistogram(Collector):
    """A histogram without labels."""

    def __init__(self, name: str, text: str, buckets: Sequence[float], registry: CollectorRegistry) -> None:
        self._name, self._text, self._bounds = name, text, tuple(buckets)
        self._names = [floatToGoString(bound) for bound in (*buckets, float("inf"))]  # type: ignore[no-untyped-call]
        self._counts = [0] * len(self._names)
        self._sum = 0.0
        self._exemplars: dict[int, Exemplar] = {}
        registry.register(self)

    def observe(self, amount: float, exemplar: dict[str, str] | None = None) -> None:
        """Count an amount; ``exemplar`` are labels that lead to a trace of it."""
        at = bisect_left(self._bounds, amount)
        self._counts[at] += 1
        self._sum += amount
        if exemplar is not None:
            self._exemplars[at] = Exemplar(exemplar, amount, time.time())

    @staticmethod
    def observe_each(histograms: Iterable[FrameHistogram], amounts: Iterable[float]) -> None:
        """Count an amount in each of several histograms."""
        for histogram, amount in zip(histograms, amounts, strict=True):
            histogram._counts[bisect_left(histogram._bounds, amount)] += 1
            histogram._sum += amount

    def collect(self) -> Iterable[HistogramMetricFamily]:
        """Return what was counted, for the registry."""
        buckets = [
            (name, float(count), self._exemplars[at]) if at in self._exemplars else (name, float(count))
            for at, (name, count) in enumerate(zip(self._names, accumulate(self._counts), strict=True))
        ]
        yield HistogramMetricFamily(self._name, self._text, buckets=buckets, sum_value=self._sum)
