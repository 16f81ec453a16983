"""Conversions at the borders."""

from __future__ import annotations

import math

import pytest

from construction_twin.core.units import display_text, format_allowance


@pytest.mark.parametrize("decimals, allowance_deg", [(3, 125.0), (6, 0.125), (1, 12_500.0)])
def test_format_allowance_is_the_design_s(decimals, allowance_deg):
    assert math.degrees(format_allowance(decimals)) == pytest.approx(allowance_deg)


@pytest.mark.parametrize(
    "value, unit, said",
    [
        (math.radians(155.0), "rad", "155 deg"),
        (math.radians(154.000001), "rad", "154.000001 deg"),
        (-0.25, "m", "-250 mm"),
        (math.pi, "rad/s", "180 deg/s"),
        (2.5, "m/s^2", "2500 mm/s^2"),
        (0.1, "s", "0.1 s"),
        (math.nan, "rad", "nan deg"),
        (math.inf, "m", "inf mm"),
        (0.0, "rad", "0 deg"),
    ],
)
def test_people_read_degrees_and_millimetres(value, unit, said):
    assert display_text(value, unit) == said
