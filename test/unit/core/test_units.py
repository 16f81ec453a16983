"""Conversions at the borders."""

from __future__ import annotations

import math

import pytest

from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, degrees, format_allowance, radians


def test_degrees_and_radians_are_tuples_and_inverse():
    assert radians([180.0, -90.0]) == (math.pi, -math.pi / 2)
    assert degrees(iter((math.pi, 0.0))) == (180.0, 0.0)


def test_one_cycle_is_the_same_in_seconds_and_nanoseconds():
    assert CYCLE * NANOSECONDS == CYCLE_NS == 4_000_000


@pytest.mark.parametrize("decimals, allowance_deg", [(3, 125.0), (6, 0.125), (1, 12_500.0)])
def test_format_allowance_is_the_design_s(decimals, allowance_deg):
    assert math.degrees(format_allowance(decimals)) == pytest.approx(allowance_deg)
