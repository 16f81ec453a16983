"""Time scaling: the curve parameter s over time t, within the limits of every joint.

The fastest motion within velocity and acceleration limits comes from toppra (for a straight line in closed form: it is
the trapezoid that toppra would find). Its acceleration jumps, so it is smoothed by two moving averages over time: the first
spreads each jump over enough time for the jerk limit, the second makes the jerk continuous. The smoothed motion starts and
ends at rest with zero acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PPoly

from construction_twin.core.motion_errors import PlanningError
from construction_twin.core.sentences import Sentence
from construction_twin.planning.curves import JointCurve
from construction_twin.planning.toppra_passes import (
    LinearConstraint,
    canlinear_colloc_to_interpolate,
    seidelWrapper,
)
from construction_twin.robot.description import RobotModel

#: Stages of toppra along the whole curve, and the fewest on each of its pieces.
STAGES = 100
PIECE_STAGES = 2
#: Second smoothing window [s]: over this time the jerk rises to its limit.
JERK_RISE = 0.02
#: Fraction of the jerk limit that is planned with; the quintics of the trajectory exceed it slightly.
JERK_FRACTION = 0.96
#: Fraction of the speed at which the curve itself uses up the jerk limit: what the motion adds by speeding up and slowing down
#: along a bend must find room beside it. Of 0.7 to 1, this makes the shortest motions.
CURVE_JERK = 0.8
#: Shortest first smoothing window [s].
SHORTEST_WINDOW = 0.02
#: Largest ds/dt, as a multiple of the median of what the velocity limits allow along the curve.
LARGEST_RATE = 10.0
#: How often a stage of the forward pass is repeated with less speed if rounding leaves no solution.
SLOWER_TRIES = 10


@dataclass(frozen=True, eq=False)
class TimeScalingLimits:
    """The part of the robot's limits that a motion may use; all symmetric.

    Attributes:
        velocity, acceleration, jerk: Shape (n,)
    """

    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray

    @classmethod
    def fractions(cls, robot: RobotModel, velocity: float, acceleration: float) -> TimeScalingLimits:
        """Return fractions of a robot's velocity and acceleration limits, and `JERK_FRACTION` of its jerk limit."""
        limits = ((velocity, robot.velocity), (acceleration, robot.acceleration), (JERK_FRACTION, robot.jerk))
        return cls(*(fraction * np.array(limit) for fraction, limit in limits))


@dataclass(frozen=True, eq=False)
class TimeScaling:
    """The curve parameter s over time, from 0 to the curve's length, from rest to rest.

    Attributes:
        duration: [s]
        derivatives: Length 3. s, ds/dt and d2s/dt2 over t in [0, `duration`].
        blur: Half-width of the smoothing: values this far before and after are averaged [s].
    """

    duration: float
    derivatives: tuple[PPoly, PPoly, PPoly]
    blur: float


@dataclass(frozen=True)
class RestToRest:
    """The fastest motion over a distance from rest to rest within limits of velocity, acceleration and jerk.

    It is the velocity trapezoid with `acceleration`, smoothed by a moving average over `window`.

    Attributes:
        distance, velocity, acceleration, window: `velocity` and `acceleration` are the values reached, at most the limits.
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
        """Return the motion smoothed to a continuous jerk, which makes it `JERK_RISE` longer."""
        ramp = self.velocity / self.acceleration
        cruise = max(self.distance / self.velocity - ramp, 0.0)
        knots = np.array([0.0, ramp, ramp + cruise, 2.0 * ramp + cruise])
        half = 0.5 * self.acceleration
        first = 0.5 * self.velocity * ramp
        s = np.array([0.0, first, first + self.velocity * cruise])
        pieces = np.array([[half, 0.0, -half], [0.0, self.velocity, self.velocity], s])
        if cruise <= 0.0:
            return smoothed(PPoly(pieces[:, [0, 2]], knots[[0, 1, 3]]), self.window, JERK_RISE)
        return smoothed(PPoly(pieces, knots), self.window, JERK_RISE)


def straight_time_scaling(curve: JointCurve, limits: TimeScalingLimits, top_speed: float = math.inf) -> TimeScaling:
    """Return the fastest smooth time scaling of a straight curve.

    Args:
        curve: With `straight` true.
        top_speed: Largest ds/dt.
    """
    direction = np.abs(curve(np.zeros(1), 1)[0])
    moving = direction > 0.0
    velocity, acceleration, jerk = (
        float(np.min(limit[moving] / direction[moving]))
        for limit in (limits.velocity, limits.acceleration, limits.jerk)
    )
    return RestToRest.fastest(curve.length, min(velocity, top_speed), acceleration, jerk).time_scaling()


class TimeScalingSearch:
    """Finds the time scaling of one curve, repeatedly with less speed where the last one was too fast.

    Args:
        curve: JointCurve or alike. With `length`, `knots` and `__call__(s, order)`.
        top_speed: Largest ds/dt.

    Raises:
        PlanningError: From `find`, if no motion is within the limits.
    """

    def __init__(self, curve, limits: TimeScalingLimits, top_speed: float = math.inf):
        self._limits = limits
        self._grid = _stages(curve.knots)
        self._first, self._second = curve(self._grid, 1), curve(self._grid, 2)
        with np.errstate(divide="ignore"):
            bound = np.min(limits.velocity / np.abs(self._first), axis=1)
        # where the curve's derivative vanishes (at a sharp corner), the velocity limits do not bound ds/dt
        self._top = np.minimum(np.minimum(bound, LARGEST_RATE * np.median(bound)), top_speed)
        if isinstance(curve, JointCurve):
            # at even speed along the curve, its third derivative alone is a jerk
            with np.errstate(divide="ignore"):
                even = np.min(np.cbrt(limits.jerk / curve.largest_third(self._grid)), axis=1)
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

    def _fastest(self) -> PPoly:
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
        if not np.all(speed[:-1] + speed[1:] > 0.0):
            raise PlanningError(Sentence("motion.timing.none"))
        ds = np.diff(grid)
        dt = 2.0 * ds / (speed[:-1] + speed[1:])
        half_acceleration = 0.25 * (speed[1:] ** 2 - speed[:-1] ** 2) / ds
        times = np.concatenate(([0.0], np.cumsum(dt)))
        return PPoly(np.stack((half_acceleration, speed[:-1], grid[:-1])), times)

    def _window(self, fastest: PPoly) -> float:
        """Return the first smoothing window for which the motion is shortest after it is slowed to the jerk limit.

        A switch between full acceleration and full deceleration needs twice the window of a switch to or from constant
        speed.
        """
        shortest = float(np.max(self._limits.acceleration / self._limits.jerk))
        end = float(fastest.x[-1])
        times = np.linspace(0.0, end, 200)
        slope = fastest.derivative(2)
        # the fraction of the jerk limit per unit of d3s/dt3; the curve's curvature adds jerk, which the stretching removes later
        fraction = np.max(np.abs(self._first) / self._limits.jerk, axis=1)
        fraction = np.interp(fastest(times), self._grid, fraction)
        best = (math.inf, SHORTEST_WINDOW)
        for window in (max(SHORTEST_WINDOW, k * shortest) for k in (1.0, 1.4, 2.0)):
            before, after = np.clip(times - 0.5 * window, 0.0, end), np.clip(times + 0.5 * window, 0.0, end)
            jump = np.abs(np.where(after < end, slope(after), 0.0) - np.where(before > 0.0, slope(before), 0.0))
            factor = max(1.0, np.cbrt(np.max(jump * fraction) / window))
            best = min(best, ((end + window) * factor, window))
        return best[1]


def smoothed(s_over_time: PPoly, first: float, second: float) -> TimeScaling:
    """Average a piecewise quadratic s(t) over two windows in time, one after the other.

    d2s/dt2 of the result is a difference of four values of s divided by the windows, hence quadratic between shifted
    knots: three samples give each piece exactly, and integrating it keeps s and its derivatives consistent.

    Args:
        s_over_time: From t = 0.
        first, second: Windows [s]; the result is longer by both.
    """
    end = s_over_time.x[-1]
    shifts = np.array([0.0, first, second, first + second])
    knots = np.sort((s_over_time.x + shifts[:, None]).ravel())
    knots = knots[np.concatenate(([True], np.diff(knots) > 1e-9 * knots[-1]))]
    h = np.diff(knots)
    at = np.stack((knots[:-1], knots[:-1] + 0.5 * h, knots[1:]))
    s0, s1, s2, s3 = s_over_time(np.clip(at - shifts[:, None, None], 0.0, end))
    start, middle, stop = ((s0 - s1) - (s2 - s3)) / (first * second)
    curve = 2.0 * (start - 2.0 * middle + stop) / h**2
    slope = (4.0 * middle - 3.0 * start - stop) / h
    sdd = PPoly(np.stack((curve, slope, start)), knots)
    sd = sdd.antiderivative()
    return TimeScaling(float(knots[-1]), (sd.antiderivative(), sd, sdd), 0.5 * (first + second))


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

    Zero speed satisfies every constraint at every stage, so the interval of speeds from which the end can be reached always
    begins at 0, and one linear program per stage and pass is enough. (toppra's own driver also solves for the lower end, and
    always formats its log.)
    """
    stages = len(steps)
    ceiling = np.zeros(stages + 1)
    upwards = np.array([1e-9, -1.0])
    for i in range(stages - 1, -1, -1):
        ceiling[i] = solver.solve_stagewise_optim(i, None, upwards, math.nan, math.nan, 0.0, ceiling[i + 1])[1]
    squares = np.zeros(stages + 1)
    for i in range(stages):
        step = 2.0 * steps[i]
        for _ in range(SLOWER_TRIES):
            u = solver.solve_stagewise_optim(
                i, None, np.array([-step, -1.0]), squares[i], squares[i], 0.0, ceiling[i + 1]
            )[0]
            if not math.isnan(u):
                break
            squares[i] *= 0.999
        squares[i + 1] = min(ceiling[i + 1], max(0.0, squares[i] + step * u))
    return squares


def _stages(knots: np.ndarray) -> np.ndarray:
    """Return toppra's grid: every knot of the curve, and enough stages between them."""
    spans = np.diff(knots)
    counts = np.maximum(PIECE_STAGES, np.ceil(STAGES * spans / knots[-1])).astype(int)
    pieces = [np.linspace(a, b, count, endpoint=False) for a, b, count in zip(knots[:-1], knots[1:], counts)]
    return np.concatenate([*pieces, knots[-1:]])
