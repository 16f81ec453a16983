"""Whether the arm can bring its tool to a pose without touching anything; whether a path leads there, planning tells."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics, NotFoundError, PoseRangeError, UnreachableError
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import KinematicsError
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.views.texts import range_sentence


class Reach(enum.Enum):
    """Whether the arm can be at a pose."""

    #: At least one joint solution touches nothing.
    FREE = "free"
    #: Every joint solution touches something.
    CONTACT = "contact"
    #: There is no joint solution.
    OUT = "out"
    #: None was found in the time given; there may be one.
    UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class PoseVerdict:
    """The answer, the joint solution that was judged, shape (n,) [rad], [m], and the two bodies that touch."""

    reach: Reach
    sentence: str
    q: np.ndarray | None = None
    between: tuple[str, ...] = ()


def judge_pose(pose: Pose, seed: Sequence[float], solver: InverseKinematics, world: CollisionWorld) -> PoseVerdict:
    """Judge a pose by the collision-free joint solution nearest to `seed`, or by the nearest if all are in contact."""
    try:
        solutions = [solution.q for solution in solver.all(pose, seed)]
    except NotFoundError as error:
        return PoseVerdict(Reach.UNKNOWN, f"no joint values found in {error.budget_s:.3g} s; there may be some")
    except KinematicsError as error:
        return PoseVerdict(Reach.OUT, out_reason(error, solver.chain.robot))
    touching: list[PoseVerdict] = []
    for q in solutions:
        contact = world.contact(q.tolist())
        if contact is None:
            return PoseVerdict(Reach.FREE, "can be reached, nothing is touched there", q)
        first, second = contact.between
        touching.append(PoseVerdict(Reach.CONTACT, f"{first} would touch {second}", q, contact.between))
    return touching[0]


def out_reason(error: KinematicsError, robot: RobotModel) -> str:
    """Return why there is no joint solution, for people: by how much the pose is out of reach, or which joint's range ends."""
    if isinstance(error, UnreachableError):
        missing = f"{error.missing * 1e3:.0f} mm"
        if error.too_close:
            return f"too close by {missing}; move it further away"
        return f"out of reach by {missing}; move it closer"
    if isinstance(error, PoseRangeError):
        return range_sentence(error.joint, error.value, robot)
    return str(error)
