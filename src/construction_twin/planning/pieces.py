"""Piecewise polynomials whose value and first two derivatives are wanted at once, at tens to hundreds of places.

`scipy.interpolate.PPoly` evaluates one order at a time, which costs more in calls than in arithmetic at these sizes.
"""

from __future__ import annotations

import numpy as np


class Pieces:
    """A piecewise polynomial of one value or of a vector.

    Args:
        knots: Shape (k,). Where the pieces meet, with both ends, ascending.
        coefficients: Shape (d + 1, k - 1) or (d + 1, k - 1, n). Of the pieces, highest power of the distance from the piece's first
            knot first, as those of `PPoly`. Degree d at least 2.
    """

    def __init__(self, knots: np.ndarray, coefficients: np.ndarray):
        self.knots = knots
        self.coefficients = coefficients
        self._inner = knots[1:-1]

    def states(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return value, first and second derivative, shape (m,) or (m, n) each.

        Args:
            x: Shape (m,). Outside of the knots the first or last piece goes on; at a knot it is the piece that begins there.
        """
        rest, coefficients = self._at(x)
        # Horner's scheme for all three: each order takes what the order below was before
        half, first, value = np.zeros_like(rest), coefficients[0], coefficients[0] * rest + coefficients[1]
        for coefficient in coefficients[2:]:
            half = half * rest + first
            first = first * rest + value
            value = value * rest + coefficient
        return value, first, 2.0 * half

    def third(self, x: np.ndarray) -> np.ndarray:
        """Return the third derivative, as `states` does."""
        rest, coefficients = self._at(x)
        degree, value = len(coefficients) - 1, np.zeros_like(coefficients[0])
        for power, coefficient in zip(range(degree, 2, -1), coefficients):
            value = value * rest + power * (power - 1) * (power - 2) * coefficient
        return value

    def _at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        piece = self._inner.searchsorted(x, side="right")
        rest, coefficients = x - self.knots[piece], self.coefficients[:, piece]
        return rest if coefficients.ndim == 2 else rest[:, None], coefficients
