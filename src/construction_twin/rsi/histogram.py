"""A histogram of times that costs nothing to fill: fixed logarithmic bins, percentiles when asked. Standard library only."""

from __future__ import annotations

import math
from bisect import bisect_left


class Histogram:
    """Counts in fixed bins.

    Parameters
    ----------
    edges : list of float
        Upper edges, ascending; what lies above the last goes into an overflow bin.
    """

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

    def percentile(self, share: float) -> float | None:
        """Return the upper edge of the bin that holds the given share of values (0 to 1); None when empty."""
        wanted = math.ceil(share * sum(self.counts))
        if wanted == 0:
            return None
        seen = 0
        for edge, count in zip([*self.edges, self.largest], self.counts):
            seen += count
            if seen >= wanted:
                return min(edge, self.largest)
        return self.largest

    def summary(self) -> dict:
        """Return edges, counts, the largest value and the usual percentiles."""
        return {
            "bins": self.edges,
            "counts": self.counts,
            "max": self.largest,
            "p50": self.percentile(0.5),
            "p99": self.percentile(0.99),
            "p99_9": self.percentile(0.999),
        }
