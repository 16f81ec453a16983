"""The cubic between stamped poses."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.interpolation import interpolate, weights

#: Any time on the sender's clock, here late in 2025.
T0 = 1_764_000_000_000_000_000
PERIODS = st.integers(1, 10**9)


def around(function, earlier, period, later):
    """Return four stamped values of `function` of time [s]: before, start, end, after."""
    stamps = (-earlier, 0, period, period + later)
    return [(T0 + stamp, (function(stamp * 1e-9),)) for stamp in stamps]


@given(PERIODS, PERIODS, PERIODS, st.floats(0, 1), st.floats(-5, 5), st.floats(-3, 3), st.floats(-3, 3))
def test_constant_acceleration_is_met_exactly_over_any_stamps(earlier, period, later, fraction, a, b, c):
    def motion(t):
        return a * t * t + b * t + c

    before, start, end, after = around(motion, earlier, period, later)
    offset = int(fraction * period)
    (value,) = interpolate(T0 + offset, start, end, before, after)
    # the last bit of a position, seen as a slope over a period that is far shorter than the one in between
    rounding = 1e-15 * period / min(earlier, later)
    assert value == pytest.approx(motion(offset * 1e-9), abs=1e-9 + rounding)


@given(PERIODS, PERIODS, PERIODS, st.floats(0, 1))
def test_weights_are_those_of_the_hermite_cubic_with_parabola_tangents(earlier, period, later, fraction):
    offset = int(fraction * period)
    e, p, n, u = Fraction(earlier), Fraction(period), Fraction(later), Fraction(offset, period)
    h00, h10, h01, h11 = 2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u, 3 * u**2 - 2 * u**3, u**3 - u**2
    q = [Fraction(value) for value in (0.3, -0.1, 0.7, 2.0)]
    slopes = [(q[1] - q[0]) / e, (q[2] - q[1]) / p, (q[3] - q[2]) / n]
    m0 = (p * slopes[0] + e * slopes[1]) / (e + p)
    m1 = (n * slopes[1] + p * slopes[2]) / (p + n)
    exact = h00 * q[1] + h10 * p * m0 + h01 * q[2] + h11 * p * m1
    a, b, c = weights(T0 + offset, T0, T0 + period, T0 - earlier, T0 + period + later)
    found = float(q[1]) + (a * float(q[1] - q[0]) + b * float(q[2] - q[1]) + c * float(q[3] - q[2]))
    assert found == pytest.approx(float(exact), abs=1e-9 * (1 + period / min(earlier, later)))


def test_stamps_give_their_own_poses_exactly():
    before, start, end, after = around(lambda t: 0.1 + t / 3, 5, 7, 11)
    for neighbours in ((before, after), (None, None)):
        assert interpolate(start[0], start, end, *neighbours) is start[1]
        assert interpolate(end[0], start, end, *neighbours) is end[1]


@given(PERIODS, st.floats(0, 1), st.floats(-7, 7), st.floats(-7, 7))
def test_between_two_poses_alone_it_is_linear_to_the_last_digits_at_any_epoch(period, fraction, a, b):
    offset = int(fraction * period)
    (value,) = interpolate(T0 + offset, (T0, (a,)), (T0 + period, (b,)))
    assert float(Fraction(a) + (Fraction(b) - Fraction(a)) * Fraction(offset, period)) == pytest.approx(
        value, abs=2e-14
    )


def test_velocity_is_continuous_at_a_stamp():
    poses = [(T0 + k * 4_000_000, (value,)) for k, value in enumerate((0.0, 0.1, 0.5, 0.4, -0.3))]
    before = interpolate(poses[2][0] - 1000, *poses[1:3], poses[0], poses[3])
    after = interpolate(poses[2][0] + 1000, *poses[2:4], poses[1], poses[4])
    left, right = 0.5 - before[0], after[0] - 0.5
    assert left == pytest.approx(right, rel=2e-3)
    assert left * 1e6 == pytest.approx((0.4 - 0.1) / 0.008, rel=2e-3)
