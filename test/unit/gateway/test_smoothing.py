"""Smoothing of played targets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.gateway.smoothing import Smoother, henderson_weights

CYCLES = (2, 3, 4, 5, 10)


def smoothed(cycles, values):
    smoother = Smoother(cycles)
    return np.array([smoother.smooth((value, -value), 0) for value in values])[:, 0]


@given(st.sampled_from(CYCLES), st.floats(-7, 7), st.lists(st.floats(-7, 7), max_size=10))
def test_at_rest_it_is_exact_to_the_last_bit(cycles, q, before):
    smoother = Smoother(cycles)
    for value in before:
        smoother.smooth((value,), 0)
    for _ in range(2 * cycles + 1):
        result = smoother.smooth((q,), 0)
    assert result == (q,)


@pytest.mark.parametrize("cycles", CYCLES)
def test_a_steady_motion_is_delayed_by_exactly_its_cycles(cycles):
    ramp = 0.01 * np.arange(100)
    np.testing.assert_allclose(smoothed(cycles, ramp)[30:], ramp[30 - cycles : 100 - cycles], atol=1e-12)
    assert Smoother(cycles).delay == cycles * CYCLE_NS


@pytest.mark.parametrize("cycles", CYCLES)
def test_velocity_acceleration_and_jerk_pass_unchanged(cycles):
    seconds = CYCLE * np.arange(200)
    motion = 0.5 * 2.7 * seconds**2 - 5.0 * seconds**3
    np.testing.assert_allclose(smoothed(cycles, motion)[50:], motion[50 - cycles : 200 - cycles], atol=1e-12)


@pytest.mark.parametrize("cycles", CYCLES)
def test_weights_are_symmetric_and_sum_up_to_one(cycles):
    weights = henderson_weights(cycles)
    assert weights == weights[::-1] and len(weights) == 2 * cycles + 1
    assert sum(weights) == pytest.approx(1.0, abs=1e-14)


def test_weights_of_nine_values_are_the_published_ones():
    assert henderson_weights(4)[:5] == pytest.approx([-0.041, -0.010, 0.119, 0.267, 0.330], abs=0.0015)


@pytest.mark.parametrize("cycles, left", [(2, 0.34), (3, 0.17), (4, 0.10), (5, 0.07), (6, 0.05)])
def test_the_ripple_of_rounding_falls_to_what_is_documented(cycles, left):
    motion = 0.3 * np.sin(0.8 * CYCLE * np.arange(20_000))
    rounded = np.radians(np.round(np.degrees(motion), 3))
    ripple = np.std(np.diff(smoothed(cycles, rounded) - smoothed(cycles, motion), 2)[50:])
    assert ripple / np.std(np.diff(rounded - motion, 2)) == pytest.approx(left, rel=0.1)


def test_a_cleared_one_begins_at_the_next_target():
    smoother = Smoother(3)
    smoother.smooth((1.0,), 0)
    smoother.clear()
    assert smoother.smooth((5.0,), 0) == (5.0,)


def test_the_stamp_of_an_average_is_that_of_what_it_stands_for():
    smoother = Smoother(3)
    for k in range(20):
        smoother.smooth((float(k),), 4_000_000 * k)
    assert (smoother.stamp(False), smoother.stamp(True)) == (4_000_000 * 16, 4_000_000 * 15)
    smoother.clear()
    smoother.smooth((2.0,), 7)
    assert (smoother.stamp(False), smoother.stamp(True)) == (7, 7)
