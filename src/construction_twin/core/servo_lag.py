"""How a servo of second order answers a setpoint that is held: exact, for any step. Standard library only."""

from __future__ import annotations

import cmath
import math


def transition_matrix(omega: float, zeta: float, period: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return exp(A * period) of (x - u, x') for x'' = -omega^2 (x - u) - 2 zeta omega x', u constant, any damping."""
    centre = -zeta * omega
    root = omega * cmath.sqrt(zeta * zeta - 1.0)
    even = cmath.cosh(root * period).real
    odd = (cmath.sinh(root * period) / root).real if root else period
    scale = math.exp(centre * period)
    return ((scale * (even - centre * odd), scale * odd), (-scale * omega * omega * odd, scale * (even + centre * odd)))
