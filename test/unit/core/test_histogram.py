"""The histogram of reply times."""

from __future__ import annotations

import math
import random

import pytest

from construction_twin.core.histogram import Histogram


def test_a_value_on_an_edge_belongs_to_the_bin_below():
    histogram = Histogram([10, 20])
    for value in (10, 10.1, 20, 20.1):
        histogram.add(value)
    assert histogram.counts == [1, 2, 1]


def test_values_above_the_last_edge_are_counted_and_give_the_true_largest():
    histogram = Histogram([10, 20])
    for value in (5, 500, 7000):
        histogram.add(value)
    assert histogram.counts == [1, 0, 2]
    assert histogram.percentile(0.99) == histogram.largest == 7000


@pytest.mark.parametrize("fraction", [0.01, 0.5, 0.9, 0.99, 0.999, 1.0])
def test_percentiles_are_at_most_one_bin_above_the_exact_ones(fraction):
    rng = random.Random(7)
    values = sorted(rng.lognormvariate(5.5, 0.8) for _ in range(5000))
    histogram = Histogram.of_microseconds()
    for value in values:
        histogram.add(value)
    exact = values[math.ceil(fraction * len(values)) - 1]
    assert exact <= histogram.percentile(fraction) <= max(exact * 1.1 + 1, histogram.edges[0])
