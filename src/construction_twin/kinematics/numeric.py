"""Inverse kinematics of any serial chain: KDL's Levenberg-Marquardt solver from many starting points, in a time budget.

The nearest solution found is not proven to be the nearest (`benchmarks/ik.py` measures it). One that has freedom left is moved
along the arm's self-motion towards the seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import NoReturn

import numpy as np
import PyKDL

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.kinematics.chain import Chain, Pose, to_frame
from construction_twin.kinematics.solution import (
    TURN,
    ArmKind,
    Configuration,
    IkSettings,
    IkSolution,
    InverseKinematics,
    NotFoundError,
    UnreachableError,
    check_pose,
    pose_error,
    refuse_configuration,
    residual,
    spaced,
)
from construction_twin.robot.description import JointValues

#: The solver ends at this error: far below the tolerance, so that what the solver accepts also passes the check.
_SOLVER_EPS = 1e-9
#: ... or when its steps get this short [rad].
_SOLVER_STEP = 1e-14
#: Solutions nearer to each other than this are one [rad].
_SAME = 1e-4
#: Most steps along the self-motion of a redundant arm, and the step below which the motion ends [rad].
_SELF_MOTIONS = 30
_SETTLED = 1e-7
#: Besides the nearest ones, `all` returns at most so many of a redundant arm.
_MOST_SPACED = 64
#: Longest step along the self-motion [rad].
_STEP = 0.4
#: Singular values below this fraction of the largest are directions in which the tip cannot move.
_RANK = 1e-6
#: Starting points and steps of the search for the position alone, which explains a failure.
_POSITION_STARTS = 8
_POSITION_STEPS = 60


class NumericInverse(InverseKinematics):
    """Inverse kinematics by search; `why` nothing better solves the arm is part of a sentence."""

    def __init__(
        self,
        chain: Chain,
        settings: IkSettings,
        rng: np.random.Generator,
        clock: Callable[[], float],
        why: str = "it was chosen",
    ):
        super().__init__(chain, settings)
        self._why = why
        self._rng = rng
        self._clock = clock
        self._redundant = len(self.ranges.lower) > 6
        self._solver = PyKDL.ChainIkSolverPos_LMA(chain.kdl, _SOLVER_EPS, settings.iterations, _SOLVER_STEP)
        self._start = PyKDL.JntArray(len(self.ranges.lower))
        self._end = PyKDL.JntArray(len(self.ranges.lower))

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("search", self._why)

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: of the solutions found, until `patience` in a row bring nothing nearer."""
        return _Search(self, pose, seed, configuration).nearest()

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`: those found, until `patience` solved starting points in a row bring nothing new."""
        return _Search(self, pose, seed, configuration).all()

    def solve_from(self, start: JointValues, target: PyKDL.Frame) -> np.ndarray:
        """Return where the solver ends from one starting point, shape (n,). Ranges are ignored, and it need not be a solution."""
        for index, value in enumerate(start):
            self._start[index] = float(value)
        self._solver.CartToJnt(self._start, target, self._end)
        return np.array([self._end[index] for index in range(len(self.ranges.lower))])

    def starting_points(self, seed: np.ndarray) -> Iterator[np.ndarray]:
        """Yield starting points: the seed, home, then random ones, near the seed and anywhere in the ranges in turn."""
        yield seed
        yield np.array(self.chain.robot.home)
        reach = np.minimum(self.ranges.upper - self.ranges.lower, TURN) / 4.0
        for number in range(self.settings.seeds - 2):
            if number % 2:
                yield self._rng.uniform(self.ranges.lower, self.ranges.upper)
            else:
                near = self._rng.normal(seed, reach)
                yield np.clip(near, self.ranges.lower, self.ranges.upper)

    def nearest_turns(self, q: np.ndarray, seed: np.ndarray) -> np.ndarray:
        """Return joint values, shape (n,), with the turns nearest to a seed; out of range by rounding: at the end of the range."""
        slack = self.settings.tolerance_rad
        q = self.ranges.into_range(q, seed, slack)
        edge = np.clip(q, self.ranges.lower, self.ranges.upper)
        return np.where(np.abs(edge - q) <= slack, edge, q)

    def is_singular(self, q: np.ndarray) -> bool:
        """Return whether there are directions in which the tip cannot move; an arm of six joints then has a self-motion."""
        values = np.linalg.svd(self.chain.jacobian(q), full_matrices=False, compute_uv=False)
        return bool(values[-1] < _RANK * values[0])

    def along_self_motion(self, q: np.ndarray, seed: np.ndarray, pose: Pose) -> np.ndarray:
        """Move a redundant or singular arm along its self-motion towards the seed, in range; the caller checks the result."""
        q = np.clip(q, self.ranges.lower, self.ranges.upper)
        for _ in range(_SELF_MOTIONS):
            error = pose_error(self.chain.forward(q), pose)
            step = self._step(q, seed - q, error)
            # joints that would leave their range stand still, and the step is computed again for the others
            stuck = ((q <= self.ranges.lower) & (step < 0.0)) | ((q >= self.ranges.upper) & (step > 0.0))
            if stuck.any():
                step = self._step(q, seed - q, error, ~stuck)
            length = float(np.abs(step).max())
            q = np.clip(q + step * min(1.0, _STEP / max(length, _STEP)), self.ranges.lower, self.ranges.upper)
            if length < _SETTLED:
                break
        return q

    def missing_position(self, pose: Pose, seed: np.ndarray) -> float:
        """Return the smallest distance found of the tip to a position within the ranges, orientation ignored [m]."""
        best = math.inf
        for q in islice(self.starting_points(seed), _POSITION_STARTS):
            for _ in range(_POSITION_STEPS):
                error = pose.position - self.chain.forward(q).position
                length = float(np.linalg.norm(error))
                if length < 0.1 * self.settings.tolerance_m:
                    return length
                step = _damped(self.chain.jacobian(q)[:3], error)
                q = np.clip(q + step, self.ranges.lower, self.ranges.upper)
            best = min(best, length)
        return best

    def _step(
        self, q: np.ndarray, desired: np.ndarray, error: np.ndarray, free: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the joint step that removes an error of the tip and is otherwise as close to a desired step as possible."""
        jacobian = self.chain.jacobian(q)
        if free is not None:
            jacobian = jacobian * free
            desired = desired * free
        return desired + np.linalg.pinv(jacobian, rcond=_RANK) @ (error - jacobian @ desired)


class _Search:
    """One target: what has been found so far."""

    def __init__(self, inverse: NumericInverse, pose: Pose, seed: JointValues, configuration: Configuration | None):
        inverse.chain.robot.check_range(seed)
        check_pose(pose)
        refuse_configuration(configuration)
        self._inverse = inverse
        self._settings = inverse.settings
        self._pose = pose
        self._target = to_frame(pose)
        self._seed = np.array(seed, dtype=float)
        self._outside: list[np.ndarray] = []
        self._unmoved: list[np.ndarray] = []
        self._residual = (math.inf, math.inf)
        self._tried = 0
        self._check_reach()

    def nearest(self) -> IkSolution:
        """Return the nearest solution found before patience or budget ran out; a typed error without any."""
        best = None
        idle = 0
        for solution in self._solutions():
            idle += 1
            if best is None or solution.distance < best.distance - _SAME:
                best = solution
                idle = 0
            if idle >= self._settings.patience:
                break
        if best is None:
            self._explain()
        return best

    def all(self) -> list[IkSolution]:
        """Return every solution found, whole turns too, nearest first; a typed error without any."""
        found: list[IkSolution] = []
        idle = 0
        for solution in self._solutions():
            idle += 1
            if all(math.dist(solution.q, other.q) > _SAME for other in found):
                found.append(solution)
                idle = 0
            if idle >= self._settings.patience:
                break
        if not found:
            self._explain()
        turned = [other for one in found for other in self._inverse.turned(one.q, self._pose, self._seed)]
        turned += self._spaced(found)
        return sorted(turned, key=lambda solution: solution.distance)

    def _spaced(self, found: list[IkSolution]) -> Iterator[IkSolution]:
        """Yield the solver's own solutions, before the self-motion, spaced apart, nearest first."""
        unmoved = np.array(sorted(self._unmoved, key=lambda q: math.dist(q, self._seed))).reshape(-1, len(self._seed))
        return spaced(
            unmoved,
            found,
            _MOST_SPACED,
            lambda number: self._inverse.confirmed(unmoved[number].tolist(), self._pose, self._seed),
        )

    def _solutions(self) -> Iterator[IkSolution]:
        """Yield solutions, one for each starting point that leads to one, while seeds and budget last.

        Nearer ones than the first are searched in the first half of the budget only.
        """
        began = self._inverse._clock()
        budget = self._settings.budget_s
        for start in self._inverse.starting_points(self._seed):
            if self._tried and self._inverse._clock() - began >= budget:
                return
            self._tried += 1
            solution = self._solve_from(start)
            if solution is not None:
                budget = 0.5 * self._settings.budget_s
                yield solution

    def _solve_from(self, start: np.ndarray) -> IkSolution | None:
        inverse = self._inverse
        q = inverse.nearest_turns(inverse.solve_from(start, self._target), self._seed)
        # forward kinematics decides whether this is the pose; the solver's own verdict is not used
        error = residual(inverse.chain, q, self._pose)
        if not inverse.is_solved(*error):
            # on an arm of metres a radian is about a metre
            self._residual = min(self._residual, error, key=lambda error: math.hypot(*error))
            return None
        if inverse._redundant or inverse.is_singular(q):
            if inverse.ranges.excesses(q).max() <= 0.0:
                self._unmoved.append(q)
            moved = inverse.along_self_motion(q, self._seed, self._pose)
            moved_error = residual(inverse.chain, moved, self._pose)
            if inverse.is_solved(*moved_error):
                q, error = moved, moved_error
        if inverse.ranges.excesses(q).max() > 0.0:
            self._outside.append(q)
            return None
        return IkSolution(q, *error, math.dist(q, self._seed), None)

    def _check_reach(self) -> None:
        chain = self._inverse.chain
        distance = float(np.linalg.norm(self._pose.position - chain.shoulder))
        if distance > chain.reach + self._settings.tolerance_m:
            raise UnreachableError(distance - chain.reach)

    def _explain(self) -> NoReturn:
        """Raise the error that nothing was found, with what the search saw besides."""
        raise NotFoundError(self._tried, self._settings.budget_s, *self._residual, self._hint())

    def _hint(self) -> str:
        """Return what the search saw besides solutions: part of a sentence, or ""."""
        inverse, robot = self._inverse, self._inverse.chain.robot
        if self._outside:
            nearest = min(self._outside, key=lambda q: inverse.ranges.excesses(q).max())
            joint = int(inverse.ranges.excesses(nearest).argmax())
            unit = "m" if robot.linear[joint] else "rad"
            return Sentence(
                "with {joint} at {value} it would be, outside its range {lower} to {upper}",
                joint=robot.joint_names[joint],
                value=Quantity(float(nearest[joint]), unit),
                lower=Quantity(robot.lower[joint], unit),
                upper=Quantity(robot.upper[joint], unit),
            )
        missing = inverse.missing_position(self._pose, self._seed)
        if self._settings.tolerance_m < missing < math.inf:
            return Sentence(
                "the nearest position found was {missing:.3} away, in any orientation", missing=Quantity(missing, "m")
            )
        return ""


def _damped(jacobian: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the damped least-squares step. The damping keeps it short near singular poses, such as a stretched arm."""
    damping = 1e-3 * float(error @ error) + 1e-9
    return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(len(error)), error)
