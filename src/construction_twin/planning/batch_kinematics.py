"""Forward kinematics, Jacobians and Newton steps for many joint vectors at once.

A path is checked at thousands of places. One numpy calculation for all of them takes as long as a few calls of KDL. The arm's
geometry comes from KDL: the Jacobian at the zero pose holds the screw axis of each joint.
"""

from __future__ import annotations

import numpy as np

from construction_twin.kinematics.chain import Chain

#: A Jacobian column with less rotation than this belongs to a prismatic joint.
_LINEAR = 1e-9


class BatchKinematics:
    """A chain's kinematics for a batch of joint vectors, shape (m, n).

    Parameters
    ----------
    chain : Chain
    """

    def __init__(self, chain: Chain):
        self.chain = chain
        zero = np.zeros(len(chain.robot.joint_names))
        tip, columns = chain.forward(zero), chain.jacobian(zero)
        self._tip = tip
        self._axes = columns[3:].T.copy()
        self._slides = columns[:3].T.copy()
        self._linear = np.linalg.norm(self._axes, axis=1) < _LINEAR
        # a point on each axis: the one nearest to the tip
        self._points = tip.position + np.cross(self._axes, self._slides)
        # Newton steps are weighted by the joints' speeds, so that fast joints take the larger part
        self._pace = np.array(chain.robot.velocity)

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the tip's poses.

        Parameters
        ----------
        q : array, shape (m, n)

        Returns
        -------
        positions : array, shape (m, 3)
        rotations : array, shape (m, 3, 3)
        """
        positions, rotations, _ = self._solve(q, False)
        return positions, rotations

    def jacobians(self, q: np.ndarray) -> np.ndarray:
        """Return the Jacobians as `Chain.jacobian`, shape (m, 6, n)."""
        return self._solve(q, True)[2]

    def errors(self, q: np.ndarray, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the twists from the tip's poses to targets near them, shape (m, 6)."""
        reached, reached_rotations, _ = self._solve(q, False)
        return _errors(reached, reached_rotations, positions, rotations)

    def newton(self, q: np.ndarray, positions: np.ndarray, rotations: np.ndarray, steps: int) -> np.ndarray:
        """Move each joint vector by Newton steps onto its target pose.

        An arm with more joints than a pose needs takes the smallest steps, measured in fractions of the joints' full speeds.

        Parameters
        ----------
        q : array, shape (m, n)
        positions, rotations : array, shape (m, 3) and (m, 3, 3)
        steps : int

        Returns
        -------
        q : array, shape (m, n)
            Neither the ranges nor the remaining error is checked.
        """
        for _ in range(steps):
            reached, reached_rotations, jacobians = self._solve(q, True)
            error = _errors(reached, reached_rotations, positions, rotations)[:, :, None]
            scaled = jacobians * self._pace
            # the damping has an effect only for an exactly singular arm
            square = scaled @ scaled.transpose(0, 2, 1) + 1e-14 * np.eye(6)
            q = q + self._pace * (scaled.transpose(0, 2, 1) @ np.linalg.solve(square, error))[:, :, 0]
        return q

    def _solve(self, q: np.ndarray, with_jacobians: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions, rotations and Jacobians; the last are empty unless asked for."""
        count, joints = q.shape
        rotations, positions = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        axes, points = np.empty((joints, count, 3)), np.empty((joints, count, 3))
        for joint in range(joints):
            if self._linear[joint]:
                axes[joint] = rotations @ self._slides[joint]
                positions = positions + q[:, joint, None] * axes[joint]
                continue
            axes[joint] = rotations @ self._axes[joint]
            points[joint] = rotations @ self._points[joint] + positions
            turned = rotations @ _turns(self._axes[joint], q[:, joint])
            positions = points[joint] - turned @ self._points[joint]
            rotations = turned
        tips = rotations @ self._tip.position + positions
        jacobians = self._columns(axes, points, tips) if with_jacobians else np.empty((0, 6, joints))
        return tips, rotations @ self._tip.rotation, jacobians

    def _columns(self, axes: np.ndarray, points: np.ndarray, tips: np.ndarray) -> np.ndarray:
        jacobians = np.zeros((len(tips), 6, len(axes)))
        for joint, (axis, point) in enumerate(zip(axes, points)):
            if self._linear[joint]:
                jacobians[:, :3, joint] = axis
            else:
                jacobians[:, :3, joint] = np.cross(axis, tips - point)
                jacobians[:, 3:, joint] = axis
        return jacobians


def angles_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles between rotations, shape (m, 3, 3) each: [rad], shape (m,)."""
    chords = np.linalg.norm((first - second).reshape(len(first), 9), axis=1)
    return 2.0 * np.arcsin(np.minimum(1.0, chords / np.sqrt(8.0)))


def _errors(positions: np.ndarray, rotations: np.ndarray, goals: np.ndarray, goal_rotations: np.ndarray) -> np.ndarray:
    turn = 0.5 * np.sum(np.cross(rotations, goal_rotations, axis=1), axis=2)
    return np.concatenate((goals - positions, turn), axis=1)


def _turns(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the rotations about one axis, shape (m, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angles)[:, None, None] * cross + (1.0 - np.cos(angles))[:, None, None] * (cross @ cross)
