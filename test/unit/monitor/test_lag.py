"""The estimate of the servo's lag: exact for a pure delay, deaf to rest, bounded for what is no lag."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.monitor.comparison import ENOUGH, MEMORY, SLOWEST, LagEstimate


def follow(
    estimate: LagEstimate, lag: float, speed: float = 0.5, samples: int = 300, noise: float = 0.0
) -> LagEstimate:
    """Let one of two joints move at constant speed, seen `lag` behind."""
    rng = random.Random(1)
    for _ in range(samples):
        late = -speed * (lag - estimate.nanoseconds / 1e9) + rng.uniform(-noise, noise)
        estimate.add_sample((late, rng.uniform(-noise, noise)), (speed, 0.0))
    return estimate


@given(st.floats(0.0, 0.05), st.floats(0.05, 3.0), st.sampled_from([1, -1]))
def test_finds_a_constant_lag(lag, speed, direction):
    estimate = follow(LagEstimate(0.05), lag, direction * speed)
    assert estimate.seconds == pytest.approx(lag, abs=2e-9)


def test_rounding_is_averaged_out():
    # 3 decimals of a degree on both sides, at 5 deg/s
    estimate = follow(LagEstimate(0.05), 0.02, math.radians(5.0), 2000, math.radians(1e-3))
    assert estimate.seconds == pytest.approx(0.02, abs=2e-5)


def test_is_unknown_until_the_arm_has_moved_long_enough():
    estimate = LagEstimate(0.05)
    follow(estimate, 0.01, samples=ENOUGH - 1)
    assert not estimate.known and math.isnan(estimate.seconds)
    follow(estimate, 0.01, samples=1)
    assert estimate.known and estimate.seconds == pytest.approx(0.01)


def test_learns_nothing_at_rest():
    estimate = LagEstimate(0.05)
    for _ in range(10 * ENOUGH):
        estimate.add_sample((0.3, 0.3), (0.7 * SLOWEST, 0.7 * SLOWEST))
    assert not estimate.known and estimate.nanoseconds == 0


def test_follows_a_lag_that_changes():
    estimate = follow(LagEstimate(0.05), 0.01)
    follow(estimate, 0.03, samples=10 * MEMORY)
    assert estimate.seconds == pytest.approx(0.03, abs=1e-6)


@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-3.0, 3.0)), max_size=200))
def test_never_leaves_its_bounds(samples):
    estimate = LagEstimate(0.05)
    for difference, velocity in samples:
        estimate.add_sample((difference,), (velocity,))
        assert 0 <= estimate.nanoseconds <= 50_000_000
