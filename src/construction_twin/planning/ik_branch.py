"""One branch of the inverse kinematics, followed along a tool path until the branch or the path ends.

Newton steps cannot change the branch: between two lies a singularity, and the steps are short enough to detect it.
"""

from __future__ import annotations

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.kinematics.batch_kinematics import BatchKinematics
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import (
    InverseKinematics,
    NotFoundError,
    PoseRangeError,
    UnreachableError,
    UnreachableOrientationError,
    pose_error,
)
from construction_twin.planning.tool_path import ToolPath
from construction_twin.robot.motion_errors import JointRangeError, KinematicsError, PlanningError


class CartesianPathError(PlanningError):
    """The tool cannot follow its path to the end.

    Attributes:
        reason: ``joint limit``, ``singularity``, ``flip``, ``unreachable``, ``not found``, ``collision`` or ``deviation``.
        fraction, distance: How far it can be followed, of the path's length and in metres.
        waypoint: The one that the tool was going to, from 0.
        cause: The error behind it.
    """

    def __init__(
        self, reason: str, fraction: float, distance: float, waypoint: int, what: str, cause: Exception | None = None
    ):
        self.reason, self.cause = reason, cause
        self.fraction, self.distance, self.waypoint = fraction, distance, waypoint
        super().__init__(
            Sentence(
                "the path ends {distance:.1} along, on the way to waypoint {waypoint} (fraction {fraction:.4f}): {what}",
                distance=Quantity(distance, "m"),
                waypoint=waypoint,
                fraction=fraction,
                what=what,
            )
        )


#: Smallest allowed singular value of the scaled Jacobian. Near a singular wrist it is about sin(A5) / sqrt(2): 0.007 is reached
#: with A5 at 0.6 deg.
SINGULAR = 0.007
#: Most Newton steps to a pose, and the error at which it counts as reached [m] and [rad].
NEWTON_STEPS = 10
REACHED = 1e-9
#: A joint so close to the end of its range stands there [rad] or [m]: some digits of the wire.
AT_END = 1e-5
#: Largest motion of a joint from one sample to the next [rad] or [m]; beyond it, shorter steps are taken.
LONGEST_STEP = 0.3
#: Distances behind the end of a branch [m] at which poses are tested for reach: a stretched arm becomes singular just before the
#: path leaves its reach.
AHEAD = (1e-4, 1e-3, 1e-2)
#: The end of a branch is found to this [m].
FINEST = 1e-5


class BranchFollower:
    """Follows a tool path from a joint vector, `start`; `pace`, shape (n,), measures the joints' steps; 0: the joint stays."""

    def __init__(self, path: ToolPath, inverse: InverseKinematics, start: np.ndarray):
        self.path = path
        self.chain = inverse.chain
        self.batch = BatchKinematics(self.chain)
        self._inverse = inverse
        robot = self.chain.robot
        self._lower, self._upper, self.pace = np.array(robot.lower), np.array(robot.upper), np.array(robot.velocity)
        self._start = start
        self._began_at_end = np.minimum(start - self._lower, self._upper - start) <= AT_END
        self._sign = self._determinant_sign(start[None])[0]
        fault = self._faults(start[None])
        if fault[0]:
            raise self._singular(0.0, start)

    def follow(self, start: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Follow the path from a joint vector over places, shape (m,), ascending [m]; CartesianPathError where the branch ends."""
        targets = [Pose(*target) for target in zip(*self.path.poses(s))]
        done = np.asarray(start)[None]
        while len(done) < len(s):
            done = np.concatenate((done, self._stride(done[-1], targets[len(done) :])))
            if len(done) < len(s):
                # shorter steps either pass this place, or end where the branch ends
                last = len(done) - 1
                done = np.concatenate(
                    (done, self._follow_in_halves(done[-1], float(s[last]), float(s[last + 1]))[None])
                )
        return done

    def _stride(self, q: np.ndarray, targets: list[Pose]) -> np.ndarray:
        """Return the joint vectors of the next targets, up to the first that one step does not reach: shape (k, n)."""
        steps = [q]
        for target in targets:
            advanced = self._advance(steps[-1], target)
            if advanced is None:
                break
            steps.append(advanced)
        reached = np.array(steps)[1:]
        faults = np.flatnonzero(self._faults(reached))
        return reached[: faults[0]] if len(faults) else reached

    def check(self, q: np.ndarray, before: np.ndarray, s_before: np.ndarray, s: np.ndarray) -> None:
        """Check that joint vectors that were not found by `follow` belong to the branch; CartesianPathError where it ends.

        `q`, shape (m, n), at places `s`; `before`, the same, on the branch a little before, at `s_before`.
        """
        far = np.any(np.abs(q - before) > LONGEST_STEP, axis=1)
        for row in np.flatnonzero(self._faults(q) | far)[:1]:
            self._follow_in_halves(before[row], float(s_before[row]), float(s[row]))

    def end_error(
        self, reason: str, s: float, what: str, cause: ConstructionTwinError | None = None
    ) -> CartesianPathError:
        """Return the error for a path that can be followed up to `s` [m]."""
        fraction = min(1.0, s / self.path.length)
        return CartesianPathError(reason, fraction, s, self.path.waypoint_at(s), what, cause)

    def _advance(self, q: np.ndarray, target: Pose) -> np.ndarray | None:
        """Return the joint vector of a pose near that of `q`; None if the Newton steps do not converge to it.

        A joint that began at the end of its range and would leave it stays there for good, where the others are enough.
        """
        reached = self._newton(q, target, self.pace)
        if reached is None or len(q) <= 6:
            return reached
        outside = (reached < self._lower) | (reached > self._upper)
        stays = outside & self._began_at_end & (q == self._start)
        if not stays.any():
            return reached
        pace = np.where(stays, 0.0, self.pace)
        held = self._newton(q, target, pace)
        if held is None:
            return reached
        self.pace = pace
        return held

    def _newton(self, q: np.ndarray, target: Pose, pace: np.ndarray) -> np.ndarray | None:
        p = q
        for _ in range(NEWTON_STEPS):
            error = pose_error(self.chain.forward(p), target)
            if np.abs(error).max() < REACHED:
                return p
            scaled = self.chain.jacobian(p) * pace
            p = p + pace * (scaled.T @ np.linalg.solve(scaled @ scaled.T + 1e-14 * np.eye(6), error))
            if np.abs(p - q).max() > LONGEST_STEP:
                return None
        return None

    def _follow_in_halves(self, q: np.ndarray, begin: float, end: float) -> np.ndarray:
        """Return the joint vector at `end`; the interval is halved until every step succeeds."""
        reached = self._advance(q, self.path.pose(end))
        if reached is not None and not self._faults(reached[None])[0]:
            return reached
        if end - begin <= FINEST:
            raise self._explain(q, begin, end, reached)
        middle = 0.5 * (begin + end)
        return self._follow_in_halves(self._follow_in_halves(q, begin, middle), middle, end)

    def _faults(self, q: np.ndarray) -> np.ndarray:
        """Return which joint vectors are out of range, singular, or beyond a singularity: shape (m,)."""
        if not len(q):
            return np.zeros(0, dtype=bool)
        outside = np.any((q < self._lower) | (q > self._upper), axis=1)
        return outside | (self._singularity(q) < SINGULAR) | (self._determinant_sign(q) != self._sign)

    def _singularity(self, q: np.ndarray) -> np.ndarray:
        """Return the smallest singular value of each joint vector's Jacobian, shape (m,); 0 at a singularity.

        Lengths are divided by half of the arm's length, so that translation and rotation are comparable.
        """
        jacobians = self.batch.frames(q)[1]
        length = 0.5 * self.chain.arm_length
        jacobians[:, :3] /= length
        jacobians[:, :, np.array(self.chain.robot.linear)] *= length
        return np.linalg.svd(jacobians, compute_uv=False)[:, -1]

    def _determinant_sign(self, q: np.ndarray) -> np.ndarray:
        """Return the sign of the Jacobian's determinant, which changes at every simple singularity."""
        if q.shape[1] != 6:
            return np.ones(len(q))
        return np.sign(np.linalg.det(self.batch.frames(q)[1]))

    def _explain(self, q: np.ndarray, begin: float, end: float, beyond: np.ndarray | None) -> CartesianPathError:
        """Return why the branch ends between `begin` and `end`; `beyond` is the joint vector that Newton steps reached, if any."""
        if beyond is not None:
            try:
                self.chain.robot.check_range(beyond)
            except JointRangeError as error:
                values = {"joint": error.joint, "problem": str(error)}
                what = Sentence("{joint} reaches its limit ({problem}); start in another configuration", **values)
                return self.end_error("joint limit", begin, what, error)
        unreachable = self._unreachable(q, begin)
        if unreachable is not None:
            what = Sentence("its waypoint cannot be reached: {problem}", problem=str(unreachable))
            return self.end_error("unreachable", begin, what, unreachable)
        if self._singularity(q[None])[0] < 2.0 * SINGULAR:
            return self._singular(begin, q)
        return self._elsewhere(q, begin, end)

    def _singular(self, s: float, q: np.ndarray) -> CartesianPathError:
        what = Sentence(
            "the arm is at a singularity (smallest singular value {measure:.4f}, expected {least}); start in another "
            "configuration, or turn or move the path",
            measure=float(self._singularity(q[None])[0]),
            least=str(SINGULAR),
        )
        return self.end_error("singularity", s, what)

    def _unreachable(self, q: np.ndarray, s: float) -> UnreachableError | None:
        """Return by how much the next waypoint is out of reach, if the path leaves the reach just behind `s`; otherwise None."""
        seed = np.clip(q, self._lower, self._upper)
        end = self.path.waypoint_end(s)
        errors = [self._reach_error(min(s + step, end), seed) for step in AHEAD]
        found = next((error for error in errors if error is not None), None)
        return found and (self._reach_error(end, seed) or found)

    def _reach_error(self, s: float, seed: np.ndarray) -> UnreachableError | None:
        try:
            self._inverse.nearest(self.path.pose(s), seed)
        except UnreachableError as error:
            return error
        except KinematicsError:
            return None  # fails for another reason than reach
        return None

    def _elsewhere(self, q: np.ndarray, begin: float, end: float) -> CartesianPathError:
        """Return the error that the inverse kinematics gives for the next pose."""
        seed = np.clip(q, self._lower, self._upper)
        try:
            other = self._inverse.nearest(self.path.pose(end), seed)
        except PoseRangeError as error:
            return self.end_error("joint limit", begin, str(error), error)
        except UnreachableOrientationError as error:
            return self.end_error("unreachable", begin, str(error), error)
        except NotFoundError as error:
            return self.end_error("not found", begin, str(error), error)
        now, then = str(self._inverse.configuration(seed)), str(other.configuration)
        what = Sentence(
            "the next pose needs another configuration ({now} here, {then} there); start in that one or move the path",
            now=now,
            then=then,
        )
        return self.end_error("flip", begin, what)
