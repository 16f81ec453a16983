"""Curves along joint paths: through the points or within their hull, smooth, as even as the polyline."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.planning.curves import rounded

PACE = np.array([1.0, 2.0, 0.5])
paths = st.lists(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3), min_size=3, max_size=9)
corner_fractions = st.floats(0.02, 1.0)


def as_path(points) -> np.ndarray | None:
    path = np.array(points)
    return path if np.all(np.max(np.abs(np.diff(path, axis=0)), axis=1) > 1e-3) else None


def check_smooth(curve) -> None:
    """Assert that value, first and second derivative go on through every knot."""
    inner = curve.knots[1:-1]
    step = 1e-9 * np.min(np.diff(curve.knots))
    for order in range(3):
        before, after = curve(inner - step, order), curve(inner + step, order)
        assert np.max(np.abs(after - before)) <= 1e-5 * max(1.0, np.max(np.abs(curve(curve.knots, order))))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(points=paths, fraction=corner_fractions)
def test_a_rounded_curve_is_smooth_and_within_the_bounds_of_its_points(points, fraction):
    path = as_path(points)
    if path is None:
        return
    curve = rounded(path, PACE, fraction)
    check_smooth(curve)
    q = curve(np.linspace(0.0, curve.length, 500))
    assert np.all(q >= path.min(axis=0) - 1e-9) and np.all(q <= path.max(axis=0) + 1e-9)
    ends = curve(np.array([0.0, curve.length]))
    assert np.max(np.abs(ends - path[[0, -1]])) < 1e-9


@pytest.mark.parametrize("fraction", [1.0, 0.5, 0.1])
def test_a_rounded_corner_misses_its_point_by_a_sixth_of_its_reach(fraction):
    path = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 3.0, 0]])
    curve = rounded(path, np.ones(3), fraction)
    reach = 0.5 * fraction
    q = curve(np.linspace(0.0, curve.length, 20001))
    assert np.min(np.linalg.norm(q - path[1], axis=1)) == pytest.approx(np.sqrt(2) * reach / 6, rel=1e-3)
    away = np.minimum(np.abs(q[:, 1]), np.abs(q[:, 0] - 1.0))
    near = np.max(np.abs(q - path[1]), axis=1) < reach
    assert np.max(away[~near]) < 1e-9 < np.max(away[near])
    # on the lines the progress is even
    speed = np.linalg.norm(curve(np.array([0.1 * (1 - reach), 3.9]), 1), axis=1)
    assert speed == pytest.approx([1.0, 1.0])
