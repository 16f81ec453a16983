"""Where along a linear axis the wrist of the arm on it passes its singularity, closely or exactly.

Near such a place the sine of the wrist's angle is sqrt(angle^2 + (slope (place - nearest place))^2), and joint 4 turns by half a
turn within a few times angle / slope: far less than the spacing of any even places if the angle is small.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

#: A swing wider than so many spacings of the places is seen without help.
_WIDE = 8.0
#: The spacing shrinks by this much from one parabola to the next, down to about this [m]: below it rounding tells.
_SHRINK, _FINEST = 20.0, 2e-6


def find_swings(
    places: np.ndarray, wrist: np.ndarray, look: Callable[[np.ndarray], np.ndarray]
) -> list[tuple[float, float, float]]:
    """Find the places where the wrist is nearest to singular, as far as joint 4 swings there faster than the places tell.

    Parameters
    ----------
    places : array, shape (m,)
        Evenly spaced [m].
    wrist : array, shape (m, k)
        |sin| of the wrist's angle of k branches, nan where there is none.
    look : callable
        Returns the same for other places.

    Returns
    -------
    swings : list of tuple
        Place [m]; width: by which distance from there joint 4 has turned by 45 degrees [m]; and the wrist's angle there [rad].
        A place may lie beyond the ends by less than the spacing.
    """
    apart = float(places[1] - places[0])
    squares = _filled(wrist**2)
    seen = np.where(np.isnan(squares), np.inf, squares)
    padded = np.pad(seen, ((1, 1), (0, 0)), constant_values=np.inf)
    rows, branches = np.nonzero((seen <= padded[:-2]) & (seen <= padded[2:]) & (seen < np.inf))
    swings = []
    for row, branch in zip(np.clip(rows, 1, len(places) - 2).tolist(), branches.tolist()):
        found = _vertex(float(places[row]), apart, squares[row - 1 : row + 2, branch])
        if found is None or abs(found[0] - places[row]) > 2.0 * apart:
            continue  # no place here is the nearest: the wrist comes no nearer than at the end of the axis
        step = apart
        while found is not None and found[1] < _WIDE * step and step > _FINEST:
            step = max(step / _SHRINK, 0.5 * _FINEST)
            middle = found[0]
            near = _filled(look(middle + step * np.array([-1.0, 0.0, 1.0])) ** 2)[:, branch]
            found = _vertex(middle, step, near)
        if found is not None and found[1] < _WIDE * apart:
            swings.append(found)
    return swings


def _filled(squares: np.ndarray) -> np.ndarray:
    """Return squares with zero where a branch is missing between two places at which it exists: the wrist is singular."""
    filled = squares.copy()
    lost = np.isnan(squares[1:-1]) & np.isfinite(squares[:-2]) & np.isfinite(squares[2:])
    filled[1:-1][lost] = 0.0
    return filled


def _vertex(middle: float, apart: float, squares: np.ndarray) -> tuple[float, float, float] | None:
    """Return place, width and angle at the lowest point of the parabola through three places; None: it is not near them."""
    before, here, after = squares.tolist()
    curvature = (before - 2.0 * here + after) / (2.0 * apart**2)
    if not curvature > 0.0:  # nan, too
        return None
    tilt = (after - before) / (2.0 * apart)
    away = -tilt / (2.0 * curvature)
    if abs(away) > _SHRINK * apart:
        return None
    lowest = max(0.0, here + 0.5 * tilt * away)
    return middle + away, math.sqrt(lowest / curvature), math.sqrt(lowest)
