"""Positions of the carriage on a linear axis at which the arm's wrist passes its singularity, closely or exactly.

Near such a position p0 the sine of the wrist's angle is sqrt(angle^2 + slope^2 (position - p0)^2), and joint 4 turns by 180 degrees
within a few times angle / slope. For a small angle this is far less than the spacing of evenly spaced positions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

#: If joint 4 needs more than this many spacings for its turn, the evenly spaced positions resolve it.
_WIDE = 8.0
#: Squared sine of the wrist's angle beyond which no position is sharp.
_SHARP = 0.25
#: From one parabola to the next the spacing shrinks by this factor, down to about this length [m]; below it rounding dominates.
_SHRINK, _FINEST = 20.0, 2e-6


@dataclass(frozen=True, slots=True)
class WristSingularity:
    """A position where the wrist comes closest to its singularity.

    Attributes:
        position: [m]; may lie beyond the ends of the axis by less than the spacing.
        width: Distance from the position at which joint 4 has turned by 45 degrees [m].
        angle: |sin| of the wrist's angle at the position; 0: exactly singular.
    """

    position: float
    width: float
    angle: float


def find_singularities(
    positions: np.ndarray, wrist: np.ndarray, measure: Callable[[np.ndarray], np.ndarray]
) -> list[WristSingularity]:
    """Find the positions where the wrist is closest to singular and joint 4 turns too fast for the given positions to resolve.

    Args:
        positions: Shape (m,). Evenly spaced [m].
        wrist: Shape (m, k). |sin| of the wrist's angle of k branches; nan where a branch does not exist.
        measure: Returns the same for other positions.
    """
    apart = float(positions[1] - positions[0])
    squares = _filled(wrist**2)
    seen = np.where(np.isnan(squares), np.inf, squares)
    lowest = np.ones(seen.shape, dtype=bool)
    lowest[1:] = seen[1:] <= seen[:-1]
    lowest[:-1] &= seen[:-1] <= seen[1:]
    # a wrist that bends by less than this from position to position is resolved by them
    lowest &= seen < _SHARP
    rows, branches = np.nonzero(lowest)
    singularities = []
    for row, branch in zip(rows.tolist(), branches.tolist()):
        row = min(max(row, 1), len(positions) - 2)
        found = _vertex(float(positions[row]), apart, squares[row - 1 : row + 2, branch])
        if found is None or abs(found.position - positions[row]) > 2.0 * apart:
            continue  # there is no minimum here: the wrist is closest to singular at the end of the axis
        if found.width > 4.0 * _WIDE * apart:
            continue  # far from sharp, even if the parabola is rough
        step = apart
        while found is not None and found.width < _WIDE * step and step > _FINEST:
            step = max(step / _SHRINK, 0.5 * _FINEST)
            middle = found.position
            near = _filled(measure(middle + step * np.array([-1.0, 0.0, 1.0])) ** 2)[:, branch]
            found = _vertex(middle, step, near)
        if found is not None and found.width < _WIDE * apart:
            singularities.append(found)
    return singularities


def _filled(squares: np.ndarray) -> np.ndarray:
    """Return squares with 0 where a branch is missing between two positions at which it exists, because the wrist is singular."""
    filled = squares.copy()
    lost = np.isnan(squares[1:-1]) & np.isfinite(squares[:-2]) & np.isfinite(squares[2:])
    filled[1:-1][lost] = 0.0
    return filled


def _vertex(middle: float, apart: float, squares: np.ndarray) -> WristSingularity | None:
    """Return the minimum of the parabola through three positions; None: it has none near them."""
    before, here, after = squares.tolist()
    curvature = (before - 2.0 * here + after) / (2.0 * apart**2)
    if not curvature > 0.0:  # nan, too
        return None
    tilt = (after - before) / (2.0 * apart)
    away = -tilt / (2.0 * curvature)
    if abs(away) > _SHRINK * apart:
        return None
    lowest = max(0.0, here + 0.5 * tilt * away)
    return WristSingularity(middle + away, math.sqrt(lowest / curvature), math.sqrt(lowest))
