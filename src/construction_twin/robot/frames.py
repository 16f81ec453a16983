"""Orientations: rotation matrices inside, quaternions x, y, z, w towards ROS, KUKA's A, B, C towards RSI.

``R = Rz(A) Ry(B) Rx(C)`` (docs/rsi.md, section 10), in rad. scipy has all of this, and takes a quarter of a second to load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from construction_twin.robot.motion_errors import KinematicsError

#: Below this |cos B| the angles A and C turn about the same axis and only their sum or difference is defined.
_GIMBAL = 1e-12
#: How far a quaternion's norm may be from 1: rounding in a message passes, an empty message (0, 0, 0, 0) does not.
_NORM_TOLERANCE = 1e-3


def rotation_to_abc(rotation) -> tuple[float, float, float]:
    """Convert a rotation, read by ``[row, column]``, to KUKA's A, B, C [rad]; B in [-pi/2, pi/2], at both ends A is 0."""
    r = rotation
    cos_b = math.hypot(r[0, 0], r[1, 0])
    a = math.atan2(r[1, 0], r[0, 0]) if cos_b > _GIMBAL else 0.0
    b = math.atan2(-r[2, 0], cos_b)
    # C is computed from the matrix after rotating it back by A, not from the matrix' last row: A and C then match each
    # other even near B = +-90 deg, where each alone is ill-defined
    sin_a, cos_a = math.sin(a), math.cos(a)
    c = math.atan2(sin_a * r[0, 2] - cos_a * r[1, 2], cos_a * r[1, 1] - sin_a * r[0, 1])
    return a, b, c


def pendant_text(frame) -> str:
    """Return a pose, read by ``[row, column]`` [m], as KUKA's pendant shows it [mm], [deg]."""
    values = [*(frame[row, 3] * 1e3 for row in range(3)), *map(math.degrees, rotation_to_abc(frame))]
    # without a minus before what is shown as zero
    return " ".join(f"{name} {round(value, 3) + 0.0:.3f}" for name, value in zip("XYZABC", values))


def abc_to_rotation(a: float, b: float, c: float) -> np.ndarray:
    """Convert KUKA's A, B, C [rad] to a rotation matrix, shape (3, 3): ``Rz(A) Ry(B) Rx(C)``."""
    sin_a, cos_a = math.sin(a), math.cos(a)
    sin_b, cos_b = math.sin(b), math.cos(b)
    sin_c, cos_c = math.sin(c), math.cos(c)
    return np.array(
        [
            [cos_a * cos_b, cos_a * sin_b * sin_c - sin_a * cos_c, cos_a * sin_b * cos_c + sin_a * sin_c],
            [sin_a * cos_b, sin_a * sin_b * sin_c + cos_a * cos_c, sin_a * sin_b * cos_c - cos_a * sin_c],
            [-sin_b, cos_b * sin_c, cos_b * cos_c],
        ]
    )


def rpy_to_rotation(rpy_deg: Sequence[float]) -> np.ndarray:
    """Return the rotation matrix, shape (3, 3), of roll, pitch and yaw about fixed axes, as in URDF and our YAML files [deg]."""
    roll, pitch, yaw = map(math.radians, rpy_deg)
    return abc_to_rotation(yaw, pitch, roll)  # about fixed axes is about the new ones in the reverse order


def rpy_to_quaternion(rpy_deg: Sequence[float]) -> np.ndarray:
    """Return the unit quaternion x, y, z, w with w >= 0 of roll, pitch and yaw about fixed axes [deg]."""
    return rotation_to_quaternion(rpy_to_rotation(rpy_deg))


def rotation_to_quaternion(rotation: np.ndarray) -> np.ndarray:
    """Convert a rotation matrix, shape (3, 3), to a unit quaternion x, y, z, w with w >= 0."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(rotation, dtype=float).tolist()
    trace = xx + yy + zz
    # each row is the quaternion times four of its own elements: by the largest of them nothing is divided by a small number
    largest = max(xx, yy, zz, trace)
    if largest == trace:
        return _canonical(zy - yz, xz - zx, yx - xy, 1.0 + trace)
    if largest == xx:
        return _canonical(1.0 - trace + 2.0 * xx, xy + yx, zx + xz, zy - yz)
    if largest == yy:
        return _canonical(xy + yx, 1.0 - trace + 2.0 * yy, yz + zy, xz - zx)
    return _canonical(zx + xz, yz + zy, 1.0 - trace + 2.0 * zz, yx - xy)


def _canonical(x: float, y: float, z: float, w: float) -> np.ndarray:
    """Return the unit quaternion along this one, of two that mean one turn: w >= 0; where w is 0, the first other one > 0."""
    first = next(filter(None, (w, x, y, z)))
    return np.array([x, y, z, w]) * (math.copysign(1.0, first) / math.hypot(x, y, z, w))


def quaternion_to_rotation(quaternion) -> np.ndarray:
    """Convert a quaternion x, y, z, w, normalised here when its norm is 1 within 1e-3, to a rotation matrix, shape (3, 3)."""
    values = np.asarray(quaternion, dtype=float)
    if values.shape != (4,) or not abs(np.linalg.norm(values) - 1.0) <= _NORM_TOLERANCE:
        raise KinematicsError(f"quaternion x, y, z, w is {values.tolist()}; expected 4 numbers of norm 1")
    x, y, z, w = (values / np.linalg.norm(values)).tolist()
    return np.array(
        [
            [x * x - y * y - z * z + w * w, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), y * y - x * x - z * z + w * w, 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), z * z - x * x - y * y + w * w],
        ]
    )
