"""Converts the goals of the command line from deg and mm to rad and m."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import abc_to_rotation


def joint_goal(values: Sequence[float], robot: RobotModel) -> tuple[float, ...]:
    """Return joint values.

    Parameters
    ----------
    values : sequence of float, length n
        [deg], or [mm] for a prismatic joint, in the order of ``robot.joint_names``.
    robot : RobotModel

    Returns
    -------
    q : tuple of float, length n
        [rad] or [m]; not checked against the ranges, which the planner does.

    Raises
    ------
    ConfigurationError
        If their number is not the number of joints.
    """
    if len(values) != len(robot.joint_names):
        expected = f"{len(robot.joint_names)} values, one for each of {', '.join(robot.joint_names)}"
        raise ConfigurationError("--joints", list(values), expected)
    return tuple(value / 1e3 if linear else math.radians(value) for value, linear in zip(values, robot.linear))


def pose_goal(values: Sequence[float]) -> Pose:
    """Return a pose.

    Parameters
    ----------
    values : sequence of float, length 6
        X, Y, Z [mm], A, B, C [deg]: KUKA's angles, about Z, the new Y, the new X.

    Returns
    -------
    frame_T_tool : Pose
    """
    x, y, z, *angles = values
    return Pose(np.array((x, y, z)) / 1e3, abc_to_rotation(*map(math.radians, angles)))
