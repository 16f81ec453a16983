"""Smooth curves through or along the points of a joint path.

A curve's parameter runs from 0 to its `length`: the time [s] that the slowest joint would need at full speed. Three kinds:

- `interpolated` passes through every point (cubic spline) and overshoots, so it can leave the range near its ends.
- `monotone` passes through every point without overshooting: it stays in range if the points do, with more curvature at them.
- `rounded` follows the straight lines and cuts the corners: a cubic B-spline, which lies in the hull of its control points on the
  polyline, so it stays in range if the points do.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline, PPoly


class PiecewisePolynomial:
    """A piecewise polynomial of one value or of a vector, of degree 2 or more; knots and coefficients as those of `PPoly`."""

    def __init__(self, knots: np.ndarray, coefficients: np.ndarray):
        self.knots = knots
        self.coefficients = coefficients
        self._inner = knots[1:-1]

    def states(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return value, first and second derivative at x, shape (m,): shape (m,) or (m, n) each.

        Outside of the knots the first or last piece goes on; at a knot it is the piece that begins there.
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


#: A knot closer than this to the one before is the same knot, as a fraction of the curve's length.
SAME_KNOT = 1e-9


class JointCurve:
    """A piecewise polynomial joint curve from parameter 0 to `length`, with continuous second derivatives; pieces meet at `knots`.

    `straight`: It is one straight line at constant speed.
    """

    def __init__(self, pieces: PPoly):
        self.straight = pieces.c.shape[:2] == (2, 1)
        # a straight line gets an empty square term
        coefficients = np.concatenate((np.zeros_like(pieces.c[:1]), pieces.c)) if self.straight else pieces.c
        self._pieces = PiecewisePolynomial(pieces.x, coefficients)
        self.knots = pieces.x
        self.length = float(pieces.x[-1])
        self.joints = coefficients.shape[2]

    def states(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate the curve and its first two derivatives, shape (m, n) each, at places of shape (m,)."""
        return self._pieces.states(s)

    def __call__(self, s: np.ndarray, order: int = 0) -> np.ndarray:
        """Evaluate the curve, or its derivative of order 1 or 2, shape (m, n), at places of shape (m,)."""
        return self._pieces.states(s)[order]

    def largest_third(self, s: np.ndarray) -> np.ndarray:
        """Return the size of the third derivative, shape (m, n), which jumps at the knots: there the larger one of both sides."""
        margin = SAME_KNOT * self.length
        before, after = np.maximum(s - margin, 0.0), np.minimum(s + margin, self.length - margin)
        return np.maximum(np.abs(self._pieces.third(before)), np.abs(self._pieces.third(after)))


def straight(start: np.ndarray, goal: np.ndarray, pace: np.ndarray) -> JointCurve:
    """Return the straight line between two different joint vectors; the full speed of each joint, `pace`, sets the parameter."""
    length = float(_spans(np.array([start, goal]), pace)[0])
    return JointCurve(PPoly(np.array([[(goal - start) / length], [start]]), [0.0, length]))


def interpolated(points: np.ndarray, pace: np.ndarray) -> JointCurve:
    """Return the cubic spline through all points, shape (m, n), of which successive ones differ; `pace` as for `straight`."""
    if len(points) == 2:
        return straight(points[0], points[1], pace)
    return JointCurve(CubicSpline(parameters(points, pace), points))


def monotone(points: np.ndarray, pace: np.ndarray) -> JointCurve:
    """Return a curve through all points along which no joint overshoots them; arguments as for `interpolated`.

    Quintics with no second derivative at the points. A slope there is the mean of the two lines', but 0 where the joint reverses,
    and at most 1.25 times the smaller one: that keeps the control points, at fifths of a segment, and the quintic between its ends.
    """
    if len(points) == 2:
        return straight(points[0], points[1], pace)
    h = _spans(points, pace)[:, None]
    knots = np.concatenate(([0.0], np.cumsum(h)))
    lines = np.diff(points, axis=0) / h
    before, after = lines[:-1], lines[1:]
    smaller = np.minimum(np.abs(before), np.abs(after))
    inner = np.where(
        before * after > 0.0, np.sign(before) * np.minimum(0.5 * np.abs(before + after), 1.25 * smaller), 0.0
    )
    slopes = np.concatenate((lines[:1], inner, lines[-1:]))
    v0, v1, step = slopes[:-1], slopes[1:], lines * h
    c3 = (10.0 * step - (6.0 * v0 + 4.0 * v1) * h) / h**3
    c4 = (-15.0 * step + (8.0 * v0 + 7.0 * v1) * h) / h**4
    c5 = (6.0 * step - 3.0 * (v0 + v1) * h) / h**5
    return JointCurve(PPoly(np.stack((c5, c4, c3, np.zeros_like(v0), v0, points[:-1])), knots))


def rounded(points: np.ndarray, pace: np.ndarray, corner_fraction: float) -> JointCurve:
    """Return a curve on the straight lines between the points, with rounded corners; `corner_fraction` in (0, 1].

    A corner is cut within `corner_fraction` times half the shorter of its two segments, along the polyline. It misses the point by
    a sixth of that, times the length of the difference of the two directions (0.24 of it at a right angle).
    """
    if len(points) == 2:
        return straight(points[0], points[1], pace)
    spans, corners = _spans(points, pace), parameters(points, pace)
    reach = 0.5 * corner_fraction * np.minimum(spans[:-1], spans[1:])
    inner = np.sort(np.concatenate((corners[1:-1] - reach, corners[1:-1], corners[1:-1] + reach)))
    length = corners[-1]
    # two corners that each use half of the same segment have a knot in common
    inner = inner[np.concatenate(([True], np.diff(inner) > SAME_KNOT * length))]
    inner = inner[(inner > SAME_KNOT * length) & (inner < (1.0 - SAME_KNOT) * length)]
    knots = np.concatenate((np.zeros(4), inner, np.full(4, length)))
    # a B-spline with its control points on a line at the means of three knots runs along that line at constant speed
    means = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    control = np.column_stack([np.interp(means, corners, column) for column in points.T])
    control[0], control[-1] = points[0], points[-1]
    # the derivatives of a B-spline are B-splines of differences of its control points: the third is a constant on each piece, the
    # second has its control points at the knots
    first = 3.0 * np.diff(control, axis=0) / (knots[4:-1] - knots[1:-4])[:, None]
    second = 2.0 * np.diff(first, axis=0) / (knots[4:-2] - knots[2:-4])[:, None]
    h = np.diff(knots[3:-3])[:, None]
    third = np.diff(second, axis=0) / h
    a0, a1 = second[:-1], second[1:]
    slopes = first[0] + np.concatenate((np.zeros_like(a0[:1]), np.cumsum(0.5 * (a0 + a1) * h, axis=0)))[:-1]
    steps = (slopes + (2.0 * a0 + a1) / 6.0 * h) * h
    values = points[0] + np.concatenate((np.zeros_like(a0[:1]), np.cumsum(steps, axis=0)))[:-1]
    return JointCurve(PPoly(np.stack((third / 6.0, 0.5 * a0, slopes, values)), knots[3:-3]))


def parameters(points: np.ndarray, pace: np.ndarray) -> np.ndarray:
    """Return the curve parameter of each point, shape (m,); on a `rounded` curve the one nearest to each corner."""
    return np.concatenate(([0.0], np.cumsum(_spans(points, pace))))


def _spans(points: np.ndarray, pace: np.ndarray) -> np.ndarray:
    return np.max(np.abs(np.diff(points, axis=0)) / pace, axis=1)
