"""One branch of the inverse kinematics, followed along a tool path for as long as it goes on.

Newton steps from the last pose to the next cannot change the branch: between two branches lies a singularity, and the
steps are short enough to see it. Where the branch ends, `Branch.end` says where and why.
"""

from __future__ import annotations

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.motion_errors import (
    CartesianPathError,
    JointRangeError,
    KinematicsError,
    NoSolutionError,
    PoseRangeError,
    UnreachableError,
)
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.planning.batch_kinematics import BatchKinematics
from construction_twin.planning.tool_path import ToolPath

#: Smallest singular value of the scaled Jacobian that a path may come to. For a wrist about the sine of its middle joint
#: over the square root of 2: 0.6 deg from straight at 0.007.
SINGULAR = 0.007
#: Newton steps until a pose must be reached, and to what [m] and [rad].
NEWTON_STEPS = 10
REACHED = 1e-9
#: Longest way of a joint from one sample to the next [rad] or [m]; more is looked at in shorter steps.
LONGEST_STEP = 0.3
#: How far behind the end of a branch [m] the path leaves the arm's reach, if that is why it ends: a stretched arm is
#: singular just before.
AHEAD = (1e-4, 1e-3, 1e-2)
#: The end of a branch is found to this [m].
FINEST = 1e-5


class Branch:
    """Follows a tool path from a joint vector.

    Parameters
    ----------
    path : ToolPath
    inverse : InverseKinematics
        Asked only why a branch ends.
    start : array, shape (n,)
        Joint values at the path's start.

    Attributes
    ----------
    path : ToolPath
    chain : Chain
    rows : BatchKinematics
    """

    def __init__(self, path: ToolPath, inverse: InverseKinematics, start: np.ndarray):
        self.path = path
        self.chain = inverse.chain
        self.rows = BatchKinematics(self.chain)
        self._inverse = inverse
        robot = self.chain.robot
        self._lower, self._upper, self._pace = np.array(robot.lower), np.array(robot.upper), np.array(robot.velocity)
        self._handedness = self._hands(start[None])[0]
        fault = self._faults(start[None])
        if fault[0]:
            raise self._singular(0.0, start)

    def walk(self, q: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Follow the path over given places.

        Parameters
        ----------
        q : array, shape (n,)
            Joint values at the first of them.
        s : array, shape (m,)
            Rising [m].

        Returns
        -------
        rows : array, shape (m, n)

        Raises
        ------
        CartesianPathError
            Where the branch ends.
        """
        targets = [Pose(*target) for target in zip(*self.path.poses(s))]
        done = np.asarray(q)[None]
        while len(done) < len(s):
            done = np.concatenate((done, self._stride(done[-1], targets[len(done) :])))
            if len(done) < len(s):
                # shorter steps either get past this place, or end where the branch does
                last = len(done) - 1
                done = np.concatenate((done, self._creep(done[-1], float(s[last]), float(s[last + 1]))[None]))
        return done

    def _stride(self, q: np.ndarray, targets: list[Pose]) -> np.ndarray:
        """Return the joint vectors of the next targets, as far as single steps lead along the branch: shape (k, n)."""
        rows = [q]
        for target in targets:
            q = self._advance(q, target)
            if q is None:
                break
            rows.append(q)
        reached = np.array(rows)[1:]
        faults = np.flatnonzero(self._faults(reached))
        return reached[: faults[0]] if len(faults) else reached

    def check(self, rows: np.ndarray, before: np.ndarray, s_before: np.ndarray, s: np.ndarray) -> None:
        """Check that joint vectors found otherwise belong to the branch.

        Parameters
        ----------
        rows : array, shape (m, n)
            At places `s`, shape (m,).
        before : array, shape (m, n)
            On the branch, at places `s_before`, each a little before that of `rows`.

        Raises
        ------
        CartesianPathError
            Where the branch ends.
        """
        far = np.any(np.abs(rows - before) > LONGEST_STEP, axis=1)
        for row in np.flatnonzero(self._faults(rows) | far)[:1]:
            self._creep(before[row], float(s_before[row]), float(s[row]))

    def end(self, reason: str, s: float, what: str, cause: ConstructionTwinError | None = None) -> CartesianPathError:
        """Return the error for a path that can be followed up to `s` [m]."""
        fraction = min(1.0, s / self.path.length)
        return CartesianPathError(reason, fraction, s, self.path.waypoint_at(s), what, cause)

    def _advance(self, q: np.ndarray, target: Pose) -> np.ndarray | None:
        """Return the joint vector of a pose near that of `q`; None when Newton steps do not lead there."""
        p = q
        for _ in range(NEWTON_STEPS):
            error = _error(self.chain.forward(p), target)
            if np.abs(error).max() < REACHED:
                return p
            scaled = self.chain.jacobian(p) * self._pace
            p = p + self._pace * (scaled.T @ np.linalg.solve(scaled @ scaled.T + 1e-14 * np.eye(6), error))
            if np.abs(p - q).max() > LONGEST_STEP:
                return None
        return None

    def _creep(self, q: np.ndarray, begin: float, end: float) -> np.ndarray:
        """Return the joint vector at `end`, reached in steps as short as it takes."""
        reached = self._advance(q, self.path.pose(end))
        if reached is not None and not self._faults(reached[None])[0]:
            return reached
        if end - begin <= FINEST:
            raise self._explain(q, begin, end, reached)
        middle = 0.5 * (begin + end)
        return self._creep(self._creep(q, begin, middle), middle, end)

    def _faults(self, rows: np.ndarray) -> np.ndarray:
        """Return which joint vectors are out of range, singular, or beyond a singularity: shape (m,)."""
        if not len(rows):
            return np.zeros(0, dtype=bool)
        outside = np.any((rows < self._lower) | (rows > self._upper), axis=1)
        return outside | (self._singularity(rows) < SINGULAR) | (self._hands(rows) != self._handedness)

    def _singularity(self, rows: np.ndarray) -> np.ndarray:
        """Return the smallest singular value of each row's Jacobian, shape (m,), with lengths in halves of the arm's length.

        So translation and rotation compare; 0 at a singularity.
        """
        jacobians = self.rows.jacobians(rows)
        length = 0.5 * self.chain.arm_length
        jacobians[:, :3] /= length
        jacobians[:, :, np.array(self.chain.robot.linear)] *= length
        return np.linalg.svd(jacobians, compute_uv=False)[:, -1]

    def _hands(self, rows: np.ndarray) -> np.ndarray:
        """Return the sign of the Jacobian's determinant, which changes at every simple singularity."""
        if rows.shape[1] != 6:
            return np.ones(len(rows))
        return np.sign(np.linalg.det(self.rows.jacobians(rows)))

    def _explain(self, q: np.ndarray, begin: float, end: float, beyond: np.ndarray | None) -> CartesianPathError:
        """Return why the branch ends between `begin` and `end`; `beyond` is where Newton steps led, if anywhere."""
        if beyond is not None:
            try:
                self.chain.robot.check_range(beyond)
            except JointRangeError as error:
                what = f"{error.joint} reaches its limit ({error}); start in another configuration or move the path"
                return self.end("joint limit", begin, what, error)
        unreachable = self._unreachable(q, begin)
        if unreachable is not None:
            return self.end("unreachable", begin, f"its waypoint cannot be reached: {unreachable}", unreachable)
        if self._singularity(q[None])[0] < 2.0 * SINGULAR:
            return self._singular(begin, q)
        return self._elsewhere(q, begin, end)

    def _singular(self, s: float, q: np.ndarray) -> CartesianPathError:
        measure = self._singularity(q[None])[0]
        what = (
            f"the arm is at a singularity (smallest singular value {measure:.4f}, expected at least {SINGULAR}), where two "
            "configurations meet; start in another configuration, or turn or move the path"
        )
        return self.end("singularity", s, what)

    def _unreachable(self, q: np.ndarray, s: float) -> UnreachableError | None:
        """Return by how much the next waypoint is out of reach, if the path leaves the reach right behind `s`."""
        seed = np.clip(q, self._lower, self._upper)
        end = self.path.waypoint_end(s)
        ahead = [self._reach_error(min(s + step, end), seed) for step in AHEAD]
        found = next((error for error in ahead if error is not None), None)
        return found and (self._reach_error(end, seed) or found)

    def _reach_error(self, s: float, seed: np.ndarray) -> UnreachableError | None:
        try:
            self._inverse.nearest(self.path.pose(s), seed)
        except UnreachableError as error:
            return error
        except KinematicsError:
            return None  # another reason, which does not say that this is out of reach
        return None

    def _elsewhere(self, q: np.ndarray, begin: float, end: float) -> CartesianPathError:
        """Return what the inverse kinematics knows of the next pose."""
        seed = np.clip(q, self._lower, self._upper)
        try:
            other = self._inverse.nearest(self.path.pose(end), seed)
        except PoseRangeError as error:
            return self.end("joint limit", begin, str(error), error)
        except NoSolutionError as error:
            return self.end("unreachable", begin, str(error), error)
        now, then = self._inverse.configuration(seed), other.configuration
        what = f"the next pose needs another configuration ({now} here, {then} there), to which no straight way leads"
        return self.end("flip", begin, f"{what}; start in that one or move the path")


def _error(reached: Pose, target: Pose) -> np.ndarray:
    """Return the twist from one pose to another near it, shape (6,)."""
    turn = target.rotation @ reached.rotation.T
    x, y, z = (target.position - reached.position).tolist()
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = turn.tolist()
    return np.array([x, y, z, 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)])
