"""How much of the limits a trajectory uses, over all joints, for assertions on whole motions."""

from __future__ import annotations

from typing import NamedTuple

from construction_twin.planning.limit_usage import check_range, sampled_usage
from construction_twin.robot.description import RobotModel
from construction_twin.robot.trajectory import Trajectory


class LimitUse(NamedTuple):
    """Largest fraction of each limit, over all joints and 4 ms samples; 1 is exactly at the limit."""

    velocity: float
    acceleration: float
    jerk: float


def limit_use(trajectory: Trajectory, robot: RobotModel) -> LimitUse:
    sampled = sampled_usage(trajectory, robot)
    check_range(sampled.positions, robot)
    usage = sampled.largest()
    return LimitUse(max(usage.velocity), max(usage.acceleration), max(usage.jerk))
