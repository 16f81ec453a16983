"""Time scaling: the curve parameter s over time t, within the limits of every joint.

The fastest motion within velocity and acceleration limits comes from toppra (for a straight line in closed form). Two moving
averages over time smooth it: the first spreads each jump of the acceleration for the jerk limit, the second makes the jerk
continuous.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.planning.curves import JointCurve, PiecewisePolynomial
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import PlanningError

#: `import toppra` imports matplotlib's pyplot, which nothing here asks for: a quarter of a second in each process that plans or
#: checks a plan. While it is imported two empty modules stand where pyplot would be; whoever draws later imports the real ones.
_DRAWS = ("matplotlib", "matplotlib.pyplot")


@contextmanager
def _without_drawing() -> Iterator[None]:
    absent = [name for name in _DRAWS if name not in sys.modules]
    sys.modules.update({name: ModuleType(name) for name in absent})
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


with _without_drawing():
    from toppra.constraint.linear_constraint import LinearConstraint, canlinear_colloc_to_interpolate
    from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper

#: Stages of toppra along the whole curve, and the fewest on each of its pieces.
STAGES = 40
PIECE_STAGES = 2
#: Second smoothing window [s]: over this time the jerk rises to its limit.
JERK_RISE = 0.02
#: Fraction of the jerk limit that is planned with: along a curve the quintics of the trajectory exceed it; along a straight line
#: they are the motion itself, and what is left is for beginning where the arm is instead of where it was to be (`work_plan`).
JERK_FRACTION = 0.96
STRAIGHT_JERK = 0.99
#: Fraction of the speed at which the curve itself uses up the jerk limit: what the motion adds by speeding up and slowing down
#: along a bend must find room beside it. Of 0.7 to 1, this makes the shortest motions.
CURVE_JERK = 0.9
#: Shortest first smoothing window [s].
SHORTEST_WINDOW = 0.02
#: Shortest phase of constant velocity or acceleration; a shorter one is left out [s].
SHORTEST_PHASE = 1e-4
#: Largest ds/dt, as a multiple of the median of what the velocity limits allow along the curve.
LARGEST_RATE = 10.0
#: How often a stage of the forward pass is repeated with less speed if rounding leaves no solution.
SLOWER_TRIES = 10


@dataclass(frozen=True, eq=False)
class TimeScalingLimits:
    """The part of the robot's limits that a motion may use, shape (n,) each; all symmetric."""

    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray

    @classmethod
    def fractions(cls, robot: RobotModel, velocity: float, acceleration: float) -> TimeScalingLimits:
        """Return fractions of a robot's velocity and acceleration limits, and all of its jerk limit."""
        return cls(
            velocity * np.array(robot.velocity), acceleration * np.array(robot.acceleration), np.array(robot.jerk)
        )


@dataclass(frozen=True, eq=False)
class TimeScaling:
    """The curve parameter s over time, from 0 to the curve's length, from rest to rest.

    Attributes:
        blur: Half-width of the smoothing [s].
        phases: The jerk is constant on each piece: a quintic that begins and ends in one is the motion itself.
    """

    pieces: PiecewisePolynomial
    blur: float
    phases: bool = False

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.pieces.knots[-1])


@dataclass(frozen=True)
class RestToRest:
    """The fastest motion over a distance from rest to rest within limits of velocity, acceleration and jerk.

    It is the trapezoid of the velocity and acceleration that are reached, smoothed by a moving average over `window` [s].
    """

    distance: float
    velocity: float
    acceleration: float
    window: float

    @classmethod
    def fastest(cls, distance: float, velocity: float, acceleration: float, jerk: float) -> RestToRest:
        """Choose the speeds for a positive distance and positive limits."""
        # the speed at which the acceleration just reaches its limit
        knee = acceleration**2 / jerk
        peak = 0.5 * (math.hypot(knee, 2.0 * math.sqrt(acceleration * distance)) - knee)
        if peak < knee:
            peak = (0.5 * distance * math.sqrt(jerk)) ** (2.0 / 3.0)
        peak = min(peak, velocity)
        used = acceleration if peak >= knee else math.sqrt(peak * jerk)
        return cls(distance, peak, used, used / jerk)

    @property
    def duration(self) -> float:
        """[s]"""
        return self.distance / self.velocity + self.velocity / self.acceleration + self.window

    def time_scaling(self) -> TimeScaling:
        """Return the motion as phases of constant jerk."""
        ramp = self.velocity / self.acceleration
        cruise = self.distance / self.velocity - ramp
        steady, even = ramp - self.window, cruise - self.window
        spans = np.array([self.window, steady, self.window, even, self.window, steady, self.window])
        jerk = self.acceleration / self.window * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
        kept = (jerk != 0.0) | (spans > SHORTEST_PHASE)
        h, jerk = spans[kept], jerk[kept]
        begin = np.cumsum(jerk * h) - jerk * h
        knots, coefficients, end = _integrated(h, np.zeros_like(h), jerk, begin)
        # what a phase that was left out would have added
        coefficients *= self.distance / end
        return TimeScaling(PiecewisePolynomial(knots, coefficients), 0.0, True)


def straight_time_scaling(curve: JointCurve, limits: TimeScalingLimits, top_speed: float = math.inf) -> TimeScaling:
    """Return the fastest time scaling of a straight curve; `top_speed` is the largest ds/dt, here and below."""
    direction = np.abs(curve(np.zeros(1), 1)[0])
    moving = direction > 0.0
    velocity, acceleration, jerk = (
        float(np.min(limit[moving] / direction[moving]))
        for limit in (limits.velocity, limits.acceleration, STRAIGHT_JERK * limits.jerk)
    )
    return RestToRest.fastest(curve.length, min(velocity, top_speed), acceleration, jerk).time_scaling()


class TimeScalingSearch:
    """Finds the time scaling of one curve, repeatedly with less speed where the last one was too fast."""

    def __init__(self, curve: JointCurve, limits: TimeScalingLimits, top_speed: float = math.inf):
        self._limits, self._jerk = limits, JERK_FRACTION * limits.jerk
        self._grid = _stages(curve.knots)
        _, self._first, self._second = curve.states(self._grid)
        with np.errstate(divide="ignore"):
            bound = np.min(limits.velocity / np.abs(self._first), axis=1)
        # where the curve's derivative vanishes (at a sharp corner), the velocity limits do not bound ds/dt
        self._top = np.minimum(np.minimum(bound, LARGEST_RATE * np.median(bound)), top_speed)
        # at even speed along the curve, its third derivative alone is a jerk
        with np.errstate(divide="ignore"):
            even = np.cbrt(np.min(self._jerk / curve.largest_third(self._grid), axis=1))
        self._top = np.minimum(self._top, CURVE_JERK * even)
        self._first_window: float | None = None

    def slow_down(self, at: np.ndarray, speed: np.ndarray) -> None:
        """Lower the largest ds/dt to `speed` at the parameters `at` (ascending), interpolated between them; inf: unchanged."""
        unbounded = 1e6 * np.max(self._top)  # finite, to be interpolated
        self._top = np.minimum(self._top, np.interp(self._grid, at, np.minimum(speed, unbounded)))

    def find(self) -> TimeScaling:
        """Return the time scaling within the present bounds."""
        fastest = self._fastest()
        if self._first_window is None:
            self._first_window = self._window(fastest)
        return smoothed(fastest, self._first_window, JERK_RISE)

    def _fastest(self) -> PiecewisePolynomial:
        grid, length = self._grid, self._grid[-1]
        # toppra's tolerances are absolute, so the curve is scaled to length 1. With time in units of sqrt(length) the
        # accelerations do not change
        constraint = _Limits(
            self._first, self._second * length, self._limits.acceleration, self._top / math.sqrt(length)
        )
        solver = seidelWrapper([constraint], constraint, grid / length, True)
        solver.setup_solver()
        speed = np.sqrt(_fastest_squares(solver, np.diff(grid) / length)) * math.sqrt(length)
        solver.close_solver()
        both = speed[:-1] + speed[1:]
        if not np.all(both > 0.0):
            raise PlanningError(Sentence("the path cannot be timed within the limits; choose another goal"))
        ds = np.diff(grid)
        half_acceleration = 0.25 * (speed[1:] ** 2 - speed[:-1] ** 2) / ds
        times = np.concatenate(([0.0], np.cumsum(2.0 * ds / both)))
        return PiecewisePolynomial(times, np.stack((half_acceleration, speed[:-1], grid[:-1])))

    def _window(self, fastest: PiecewisePolynomial) -> float:
        """Return the first smoothing window for which the motion is shortest after it is slowed to the jerk limit."""
        shortest = float(np.max(self._limits.acceleration / self._jerk))
        end = float(fastest.knots[-1])
        times = np.linspace(0.0, end, 200)
        # the fraction of the jerk limit per unit of d3s/dt3; the curve's curvature adds jerk, which the stretching removes later
        fraction = np.max(np.abs(self._first) / self._jerk, axis=1)
        fraction = np.interp(fastest.states(times)[0], self._grid, fraction)
        best = (math.inf, SHORTEST_WINDOW)
        for window in (max(SHORTEST_WINDOW, k * shortest) for k in (1.0, 1.4, 2.0)):
            before, after = times - 0.5 * window, times + 0.5 * window
            slopes = fastest.states(np.concatenate((after, before)))[2]
            # at rest before and after
            slopes[np.concatenate((after >= end, before <= 0.0))] = 0.0
            jump = np.abs(slopes[: len(times)] - slopes[len(times) :])
            factor = max(1.0, np.cbrt(np.max(jump * fraction) / window))
            best = min(best, ((end + window) * factor, window))
        return best[1]


def smoothed(s_over_time: PiecewisePolynomial, first: float, second: float) -> TimeScaling:
    """Average a piecewise quadratic s(t), from t = 0, over two windows in time, one after the other [s]; longer by both.

    Between shifted knots d2s/dt2 of the result is quadratic: three samples give each piece exactly, and it is integrated.
    """
    end = s_over_time.knots[-1]
    shifts = np.array([0.0, first, second, first + second])
    knots = np.sort((s_over_time.knots + shifts[:, None]).ravel())
    knots = knots[np.concatenate(([True], np.diff(knots) > 1e-9 * knots[-1]))]
    h = np.diff(knots)
    at = np.stack((knots[:-1], knots[:-1] + 0.5 * h, knots[1:]))
    shifted = np.minimum(np.maximum(at - shifts[:, None, None], 0.0), end)
    s0, s1, s2, s3 = s_over_time.states(shifted.ravel())[0].reshape(shifted.shape)
    start, middle, stop = ((s0 - s1) - (s2 - s3)) / (first * second)
    curve = 2.0 * (start - 2.0 * middle + stop) / h**2
    slope = (4.0 * middle - 3.0 * start - stop) / h
    return TimeScaling(PiecewisePolynomial(*_integrated(h, curve, slope, start)[:2]), 0.5 * (first + second))


def _integrated(
    h: np.ndarray, square: np.ndarray, linear: np.ndarray, constant: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Integrate d2s/dt2 from rest at s = 0; return knots and coefficients for a `PiecewisePolynomial`, and s at the end.

    `h`: durations of the pieces, shape (k,) [s]; the others: d2s/dt2 of each by powers of the time since its begin.
    """
    speeds = np.concatenate(([0.0], np.cumsum(((square / 3.0 * h + 0.5 * linear) * h + constant) * h)))
    fourth, third, second = square / 12.0, linear / 6.0, 0.5 * constant
    ways = np.concatenate(([0.0], np.cumsum((((fourth * h + third) * h + second) * h + speeds[:-1]) * h)))
    knots = np.concatenate(([0.0], np.cumsum(h)))
    return knots, np.stack((fourth, third, second, speeds[:-1], ways[:-1])), float(ways[-1])


class _Limits(LinearConstraint):
    """Acceleration limits and the largest speed at each stage, as toppra's constraint.

    (toppra's own constraints would evaluate the curve again and format a description each time.)
    """

    def __init__(self, first: np.ndarray, second: np.ndarray, acceleration: np.ndarray, top: np.ndarray):
        super().__init__()
        self.dof = first.shape[1]
        self.identical = True  # the same two matrices at every stage
        self._first, self._second, self._acceleration = first, second, acceleration
        self._squares = np.column_stack((np.zeros(len(top)), top**2))

    def compute_constraint_params(self, _path, grid):
        """Return the constraint's coefficients at every stage, as toppra asks for them."""
        both_signs = np.concatenate((np.eye(self.dof), -np.eye(self.dof)))
        bounds = np.concatenate((self._acceleration, self._acceleration))
        none = np.zeros_like(self._first)
        return canlinear_colloc_to_interpolate(
            self._first, self._second, none, both_signs, bounds, None, self._squares, grid, identical=True
        )


def _fastest_squares(solver: seidelWrapper, steps: np.ndarray) -> np.ndarray:
    """Return the largest (ds/dt)^2 at each stage, from rest to rest: toppra's two passes.

    Zero speed satisfies every constraint, so the interval of speeds from which the end can be reached begins at 0: one linear
    program per stage and pass is enough.
    """
    stages = len(steps)
    ceiling = np.zeros(stages + 1)
    upwards = np.array([1e-9, -1.0])
    for i in range(stages - 1, -1, -1):
        ceiling[i] = solver.solve_stagewise_optim(i, None, upwards, math.nan, math.nan, 0.0, ceiling[i + 1])[1]
    squares = np.zeros(stages + 1)
    forwards = np.array([0.0, -1.0])
    for i in range(stages):
        step = 2.0 * steps[i]
        forwards[0] = -step
        for _ in range(SLOWER_TRIES):
            u = solver.solve_stagewise_optim(i, None, forwards, squares[i], squares[i], 0.0, ceiling[i + 1])[0]
            if not math.isnan(u):
                break
            squares[i] *= 0.999
        squares[i + 1] = min(ceiling[i + 1], max(0.0, squares[i] + step * u))
    return squares


def _stages(knots: np.ndarray) -> np.ndarray:
    """Return toppra's grid: every knot of the curve, and enough stages between them."""
    spans = np.diff(knots)
    counts = np.maximum(PIECE_STAGES, np.ceil(STAGES * spans / knots[-1])).astype(int)
    piece = np.repeat(np.arange(len(spans)), counts)
    place = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.append(place * (spans / counts)[piece] + knots[piece], knots[-1])
