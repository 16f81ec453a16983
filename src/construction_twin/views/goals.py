"""Converts the goals of the command line from deg and mm to rad and m."""

from __future__ import annotations

import math
from collections.abc import Sequence

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Pose, pendant_frame, to_pose
from construction_twin.robot.description import RobotModel

#: A goal whose X, Y and Z are all below this lies inside of the robot's foot; in metres it is a place like any other [mm].
NEAR_MM = 10.0
#: Frames that stand where the robot does.
_STANDING = ("", "base_link", "base", "world")


def joint_goal(values: Sequence[float], robot: RobotModel) -> tuple[float, ...]:
    """Return joint values [rad], [m] of those given in [deg], [mm]; ConfigurationError where their number is wrong."""
    if len(values) != len(robot.joint_names):
        expected = f"{len(robot.joint_names)} values, one for each of {', '.join(robot.joint_names)}"
        raise ConfigurationError("--joints", list(values), expected)
    return tuple(value / 1e3 if linear else math.radians(value) for value, linear in zip(values, robot.linear))


def pose_goal(values: Sequence[float], frame: str = "") -> Pose:
    """Return a pose of X, Y, Z [mm] and KUKA's angles A, B, C [deg] in a frame, by default the robot's base.

    ConfigurationError where it is so near to base or world that metres were probably meant: they are never converted.
    """
    x, y, z = values[:3]
    # in a frame on the tool or on an element a few mm are a goal like any other
    if frame.rpartition("/")[2] in _STANDING and 0.0 < max(abs(x), abs(y), abs(z)) < NEAR_MM:
        given = f"{x:g} {y:g} {z:g}"
        expected = (
            f"X, Y, Z in mm: this is inside of the robot's foot, less than {NEAR_MM:g} mm from the origin "
            f"of {frame or 'its base'}, and probably in metres. If so, give {x * 1e3:g} {y * 1e3:g} {z * 1e3:g}"
        )
        raise ConfigurationError("--pose", given, expected)
    return to_pose(pendant_frame(values))
