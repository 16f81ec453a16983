"""Timed joint motions: waypoints with position, velocity and acceleration, SI, joined by quintic segments."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from construction_twin.robot.motion_errors import TrajectoryError


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Waypoints of a joint motion, first at 0 s; between two of them it is the quintic polynomial that meets the state at both.

    Times are whole nanoseconds, as in a ROS duration, so that a trajectory and its hash survive a message; arrays are read-only
    copies of shape (k,) and (k, n).
    """

    joint_names: tuple[str, ...]
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    _knots: list = field(init=False)
    _coefficients: np.ndarray = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        if not self.joint_names or len(set(self.joint_names)) != len(self.joint_names):
            raise TrajectoryError(f"joint names are {self.joint_names}; expected at least one and all different")
        times = _frozen_array("times", self.times, 1)
        object.__setattr__(self, "times", _check_times(times))
        shape = (len(times), len(self.joint_names))
        for name in ("positions", "velocities", "accelerations"):
            values = _frozen_array(name, getattr(self, name), 2)
            object.__setattr__(self, name, values)
            self._check_values(name, values, shape)
        # `sample` runs at 250 Hz and searches the knots by bisection, which is several times faster on a list than on an array
        object.__setattr__(self, "_knots", self.times.tolist())
        object.__setattr__(self, "_coefficients", _quintic_coefficients(self))

    def __repr__(self) -> str:
        return f"Trajectory({len(self.times)} waypoints of {', '.join(self.joint_names)} in {self.duration:.3f} s)"

    @property
    def duration(self) -> float:
        """Time of the last waypoint [s]."""
        return self._knots[-1]

    def sample(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate the motion at one time; before 0 and after `duration` it rests at its first or last position."""
        knots = self._knots
        if not 0.0 <= t < knots[-1]:
            return self._sample_end(t)
        segment = bisect_right(knots, t) - 1
        x = t - knots[segment]
        x2 = x * x
        x3 = x2 * x
        x4 = x3 * x
        powers = np.array(
            (
                (1.0, x, x2, x3, x4, x4 * x),
                (0.0, 1.0, 2.0 * x, 3.0 * x2, 4.0 * x3, 5.0 * x4),
                (0.0, 0.0, 2.0, 6.0 * x, 12.0 * x2, 20.0 * x3),
            )
        )
        q, qd, qdd = powers @ self._coefficients[segment]
        return q, qd, qdd

    def sample_many(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate position, velocity, acceleration and jerk, shape (m, n) each, at times, shape (m,), clamped as in `sample`."""
        times = np.asarray(times, dtype=np.float64)
        segment = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        x = (np.clip(times, 0.0, self.duration) - self.times[segment])[:, None]
        coefficients = self._coefficients[segment]
        # Horner's scheme for the value and three derivatives, each from the one below before its update
        q = coefficients[:, 5] * x + coefficients[:, 4]
        qd, half, sixth = coefficients[:, 5], np.zeros_like(q), np.zeros_like(q)
        for degree in (3, 2, 1, 0):
            sixth = sixth * x + half
            half = half * x + qd
            qd = qd * x + q
            q = q * x + coefficients[:, degree]
        qdd, qddd = 2.0 * half, 6.0 * sixth
        outside = (times < 0.0) | (times > self.duration)
        for value in (qd, qdd, qddd):
            value[outside] = 0.0
        q[times >= self.duration] = self.positions[-1]
        return q, qd, qdd, qddd

    def content_hash(self) -> str:
        """Return the SHA-256 (hex) over names and all values, to the last bit; -0.0 and 0.0 differ."""
        digest = hashlib.sha256()
        digest.update("\0".join(self.joint_names).encode() + b"\0\0")
        for values in (self.times, self.positions, self.velocities, self.accelerations):
            digest.update(values.astype("<f8").tobytes())
        return digest.hexdigest()

    def _sample_end(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        row = 0 if t < 0.0 else -1
        if t == self._knots[-1]:
            return self.positions[row].copy(), self.velocities[row].copy(), self.accelerations[row].copy()
        if t != t:
            raise TrajectoryError("a trajectory cannot be sampled at time nan")
        rest = np.zeros(len(self.joint_names))
        return self.positions[row].copy(), rest, rest.copy()

    def _check_values(self, name: str, values: np.ndarray, shape: tuple[int, int]) -> None:
        if values.shape != shape:
            raise TrajectoryError(f"{name} have shape {values.shape}; expected {shape}, waypoints by joints")
        wrong = np.argwhere(~np.isfinite(values))
        if len(wrong):
            row, joint = wrong[0]
            raise TrajectoryError(
                f"{name} of waypoint {int(row)}: {self.joint_names[joint]} is {float(values[row, joint])}, "
                "not a finite number"
            )


def whole_nanoseconds(times: np.ndarray) -> np.ndarray:
    """Round times [s] to whole nanoseconds, as of a ROS duration: each equal to some ``integer / 1e9`` to the last bit."""
    return np.round(np.asarray(times, dtype=np.float64) * 1e9) / 1e9


def _frozen_array(name: str, values, dimensions: int) -> np.ndarray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TrajectoryError(f"{name} are not a regular array of numbers: {error}") from error
    if array.ndim != dimensions:
        raise TrajectoryError(f"{name} have {array.ndim} dimensions; expected {dimensions}")
    array.flags.writeable = False
    return array


def _check_times(times: np.ndarray) -> np.ndarray:
    if len(times) < 2:
        raise TrajectoryError(f"{len(times)} waypoints; a motion needs at least two")
    if not np.all(np.isfinite(times)):
        row = int(np.argmin(np.isfinite(times)))
        raise TrajectoryError(f"time of waypoint {row} is {float(times[row])}, not a finite number")
    times = whole_nanoseconds(times)
    if times[0] != 0.0:
        raise TrajectoryError(f"the first waypoint is at {float(times[0])} s; expected 0")
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        row = int(late[0]) + 1
        raise TrajectoryError(
            f"waypoint {row} is at {float(times[row]):.9f} s, not after the one before at {float(times[row - 1]):.9f} s"
        )
    times[0] = 0.0  # -0.0 would change the hash
    times.flags.writeable = False
    return times


def _quintic_coefficients(trajectory: Trajectory) -> np.ndarray:
    """Return the segments' coefficients by ascending power of the time in the segment, shape (k - 1, 6, n)."""
    h = np.diff(trajectory.times)[:, None]
    q0, q1 = trajectory.positions[:-1], trajectory.positions[1:]
    v0, v1 = trajectory.velocities[:-1], trajectory.velocities[1:]
    a0, a1 = trajectory.accelerations[:-1], trajectory.accelerations[1:]
    step = q1 - q0
    h2 = h * h
    c3 = (20.0 * step - (8.0 * v1 + 12.0 * v0) * h - (3.0 * a0 - a1) * h2) / (2.0 * h2 * h)
    c4 = (-30.0 * step + (14.0 * v1 + 16.0 * v0) * h + (3.0 * a0 - 2.0 * a1) * h2) / (2.0 * h2 * h2)
    c5 = (12.0 * step - 6.0 * (v1 + v0) * h + (a1 - a0) * h2) / (2.0 * h2 * h2 * h)
    return np.stack((q0, v0, 0.5 * a0, c3, c4, c5), axis=1)
