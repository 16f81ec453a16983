"""Forward kinematics, Jacobians and Newton steps of many joint vectors at once: from ten on quicker than KDL one by one.

Product of exponentials: every joint moves all that follows it about its axis in the zero posture. Poses are ``base_T_tip`` [m];
joint values [rad], or [m] for a prismatic joint.
"""

from __future__ import annotations

import numpy as np

from construction_twin.kinematics.chain import Chain, joint_axes

#: Keeps steps short where the tip cannot move in a direction.
_DAMPING = 1e-14
_DIAGONAL, _ONE = np.arange(6), np.eye(4)
#: So many joint vectors are computed together: their arrays stay in the processor's cache.
_BATCH = 128


class BatchKinematics:
    """A chain's kinematics for a batch of joint vectors."""

    def __init__(self, chain: Chain):
        axes = joint_axes(chain)
        self._linear = np.array(chain.robot.linear)
        self._prismatic = any(chain.robot.linear)
        self._directions = np.array([axis.direction for axis in axes])
        self._points = np.array([axis.point for axis in axes])
        home = chain.forward([0.0] * len(axes))
        self._home = np.eye(4)
        self._home[:3, :3], self._home[:3, 3] = home.rotation, home.position
        # Newton steps are weighted by the joints' speeds, so that fast joints take the larger part
        self._pace = np.array(chain.robot.velocity)
        # the exponential of a joint is constant + sine s + (cosine - 1) c + value v
        count = len(axes)
        self._sine, self._cosine, self._value = (np.zeros((count, 4, 4)) for _ in range(3))
        for joint, axis in enumerate(axes):
            x, y, z = axis.direction
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            if self._linear[joint]:
                self._value[joint, :3, 3] = axis.direction
            else:
                self._sine[joint, :3, :3], self._cosine[joint, :3, :3] = cross, -cross @ cross
                self._sine[joint, :3, 3], self._cosine[joint, :3, 3] = -cross @ axis.point, cross @ cross @ axis.point

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the tip's poses, shape (k, 4, 4), and the Jacobians, shape (k, 6, n), as `Chain.jacobian`; `q` is (k, n)."""
        if len(q) > _BATCH:
            parts = [self.frames(q[first : first + _BATCH]) for first in range(0, len(q), _BATCH)]
            return np.concatenate([tip for tip, _ in parts]), np.concatenate([jacobian for _, jacobian in parts])
        before, tip = self._products(q)
        turned = before[:, :, :3, :3]
        direction = (turned @ self._directions[:, None, :, None])[..., 0]
        lever = tip[:, :3, 3] - before[:, :, :3, 3] - (turned @ self._points[:, None, :, None])[..., 0]
        jacobian = np.empty((6, q.shape[1], len(q)))
        x, y, z = direction.transpose(2, 0, 1)
        u, v, w = lever.transpose(2, 0, 1)
        jacobian[0], jacobian[1], jacobian[2] = y * w - z * v, z * u - x * w, x * v - y * u
        jacobian[3], jacobian[4], jacobian[5] = x, y, z
        if self._prismatic:
            jacobian[:3, self._linear] = jacobian[3:, self._linear]
            jacobian[3:, self._linear] = 0.0
        return tip, jacobian.transpose(2, 0, 1)

    def _products(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what moves each joint, shape (n, k, 4, 4), and the tip, shape (k, 4, 4)."""
        moves = np.sin(q)[:, :, None, None] * self._sine + (np.cos(q) - 1.0)[:, :, None, None] * self._cosine
        if self._prismatic:
            moves += q[:, :, None, None] * self._value
        moves += _ONE
        count, joints = q.shape
        before = np.empty((joints, count, 4, 4))
        before[0] = _ONE
        for joint in range(joints - 1):
            np.matmul(before[joint], moves[:, joint], out=before[joint + 1])
        return before, before[-1] @ moves[:, -1] @ self._home

    def _tips(self, q: np.ndarray) -> np.ndarray:
        if len(q) <= _BATCH:
            return self._products(q)[1]
        return np.concatenate([self._tips(q[first : first + _BATCH]) for first in range(0, len(q), _BATCH)])

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the tip's positions, shape (k, 3), and rotations, shape (k, 3, 3)."""
        tip = self._tips(q)
        return tip[:, :3, 3], tip[:, :3, :3]

    def errors(self, q: np.ndarray, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the twists from the tip's poses to targets near them, shape (k, 6)."""
        return _twists(self._tips(q), positions, rotations)

    def newton(
        self, q: np.ndarray, positions: np.ndarray, rotations: np.ndarray, steps: int, pace: np.ndarray | None = None
    ) -> np.ndarray:
        """Move each joint vector by Newton steps onto its own target pose; the caller checks ranges and the remaining error.

        Redundant arms take the smallest steps, in fractions of full speed, or of `pace`, shape (n,): 0, and the joint stays.
        """
        pace = self._pace if pace is None else pace
        for _ in range(steps):
            tip, jacobian = self.frames(q)
            error = _twists(tip, positions, rotations)
            q = q + pace * _least_steps(jacobian * pace, error)
        return q


def angles_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles between rotations, shape (k, 3, 3) each: [rad], shape (k,)."""
    chords = np.linalg.norm((first - second).reshape(len(first), 9), axis=1)
    return 2.0 * np.arcsin(np.minimum(1.0, chords / np.sqrt(8.0)))


def _twists(tip: np.ndarray, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Return the twists to targets near the poses `tip`, shape (k, 6)."""
    error = np.empty((len(tip), 6))
    error[:, :3] = positions - tip[:, :3, 3]
    turn = rotations @ tip[:, :3, :3].transpose(0, 2, 1)
    error[:, 3] = 0.5 * (turn[:, 2, 1] - turn[:, 1, 2])
    error[:, 4] = 0.5 * (turn[:, 0, 2] - turn[:, 2, 0])
    error[:, 5] = 0.5 * (turn[:, 1, 0] - turn[:, 0, 1])
    return error


def _least_steps(jacobian: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the steps of least length that a Jacobian maps to an error; damped where the tip cannot move in a direction."""
    back = jacobian.transpose(0, 2, 1)
    square = jacobian @ back
    square[:, _DIAGONAL, _DIAGONAL] += _DAMPING
    return (back @ np.linalg.solve(square, error[:, :, None]))[:, :, 0]
