"""A histogram of times that costs nothing to fill: fixed logarithmic bins, percentiles when asked. Standard library only."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence


def percentile(edges: Sequence[float], counts: Sequence[int], fraction: float) -> float | None:
    """Return the upper edge of the bin with a fraction, (0, 1], of all counts; None: beyond the last edge, or none counted."""
    wanted = math.ceil(fraction * sum(counts) - 1e-9)
    counted = 0
    for edge, count in zip(edges, counts):
        counted += count
        if wanted and counted >= wanted:
            return edge
    return None


class Histogram:
    """Counts in fixed bins."""

    def __init__(self, edges: list[float]):
        self.edges = edges
        self.counts = [0] * (len(edges) + 1)
        self.largest = 0.0

    @classmethod
    def of_microseconds(cls) -> Histogram:
        """Return bins from 10 us to 100 ms, each 10 % wider than the one before."""
        return cls([round(10 * 1.1**k) for k in range(4, 98)])

    def add(self, value: float) -> None:
        """Count one value."""
        self.counts[bisect_left(self.edges, value)] += 1
        if value > self.largest:
            self.largest = value

    def percentile(self, fraction: float) -> float | None:
        """Return `percentile` of the values so far, never more than the largest; None when there is none."""
        if not any(self.counts):
            return None
        edge = percentile(self.edges, self.counts, fraction)
        return self.largest if edge is None else min(edge, self.largest)

    def summary(self) -> dict:
        """Return edges, counts, the largest value and the usual percentiles; a copy, which no other thread's values change."""
        return {
            "bins": self.edges,
            "counts": list(self.counts),
            "max": self.largest,
            "p50": self.percentile(0.5),
            "p99": self.percentile(0.99),
            "p99_9": self.percentile(0.999),
        }
