"""Conversions used at the borders: the wire and the RSI codecs. Inside the package everything is SI.

Standard library only: the gateway on the cell PC imports it.
"""

from __future__ import annotations

import math

#: Length of a controller cycle [s] (`#IPO_FAST`, rsi.md section 1).
CYCLE = 0.004
#: The same in nanoseconds: stamps are integers so that a grid of them stays exact.
CYCLE_NS = 4_000_000
NANOSECONDS = 1_000_000_000


def degrees(values) -> tuple[float, ...]:
    """Convert joint angles from rad to deg."""
    return tuple(math.degrees(value) for value in values)


def radians(values) -> tuple[float, ...]:
    """Convert joint angles from deg to rad."""
    return tuple(math.radians(value) for value in values)


def format_allowance(decimals: int) -> float:
    """Return what rounding to `decimals` of a degree can add to an acceleration measured per cycle.

    Second differences of values rounded to 10^-d deg carry up to 2 * 10^-d deg of rounding (design, law 3):
    125 deg/s^2 at 3 decimals, 0.125 at 6.

    Parameters
    ----------
    decimals : int
        Decimals of a degree on the wire.

    Returns
    -------
    allowance : float
        [rad/s^2]
    """
    return math.radians(2 * 10.0**-decimals) / CYCLE**2
