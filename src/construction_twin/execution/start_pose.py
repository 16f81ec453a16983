"""A plan begins where the robot is, or not at all. Pure; angles in rad, m for linear joints."""

from __future__ import annotations

from construction_twin.core.errors import ReviewError
from construction_twin.core.limits import outside_tolerance
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan

#: A plan may start this far from the present pose [rad]; rounding, not motion.
START_TOLERANCE = 1e-6


def check_start_pose(plan: Plan, pose: tuple[float, ...], robot: RobotModel) -> None:
    """Check that a plan starts at a pose, shape (n,) [rad].

    Raises
    ------
    ReviewError
        Naming the joint that does not, and by how much.
    """
    start = tuple(plan.trajectory.positions[0])
    off = outside_tolerance(start, pose, START_TOLERANCE)
    if off is not None:
        joint, unit = robot.joint_names[off], "m" if robot.linear[off] else "rad"
        distance = f"{start[off] - pose[off]:.6f} {unit}"
        raise ReviewError(f"plan {plan.id} starts {distance} from the present pose at {joint}; plan again")
