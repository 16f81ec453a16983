"""Can the arm bring its tool to a pose, without touching anything? The quick answer for somebody who drags a marker.

What it finds is what `planning.planner.Planner.plan_to_pose` starts from: the same solutions, the same contacts. A way there is
another question, which only planning answers. SI; poses ``base_T_tool``; sentences in deg and mm.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.core.motion_errors import KinematicsError, PoseRangeError, UnreachableError
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.robot.description import RobotModel
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.views.texts import range_sentence


class Reach(enum.Enum):
    """What a pose is for the arm."""

    #: At least one joint solution touches nothing.
    FREE = "free"
    #: Every joint solution touches something.
    CONTACT = "contact"
    #: There is no joint solution.
    OUT = "out"


@dataclass(frozen=True, eq=False)
class PoseVerdict:
    """The answer.

    Attributes
    ----------
    reach : Reach
    sentence : str
        Why, for people.
    q : array, shape (n,), or None
        The joint solution nearest to the seed that it is about [rad], [m] for linear joints.
    between : tuple of str, length 0 or 2
        Which two touch.
    """

    reach: Reach
    sentence: str
    q: np.ndarray | None = None
    between: tuple[str, ...] = ()


def judge_pose(pose: Pose, seed: Sequence[float], solver: InverseKinematics, world: CollisionWorld) -> PoseVerdict:
    """Judge a pose.

    Parameters
    ----------
    pose : Pose
    seed : sequence of float, length n
        Where the arm is, within its ranges.
    solver : InverseKinematics
    world : CollisionWorld

    Returns
    -------
    verdict : PoseVerdict
        Of the nearest joint solution that is free; if none is, of the nearest one.
    """
    try:
        solutions = [solution.q for solution in solver.all(pose, seed)]
    except KinematicsError as error:
        return PoseVerdict(Reach.OUT, why_out(error, solver.chain.robot))
    for q in solutions:
        if world.is_free(q):
            return PoseVerdict(Reach.FREE, "can be reached, nothing is touched there", q)
    contact = world.contact(solutions[0])
    first, second = contact.between
    return PoseVerdict(Reach.CONTACT, f"{first} would touch {second}", solutions[0], contact.between)


def why_out(error: KinematicsError, robot: RobotModel) -> str:
    """Return why there is no joint solution, for people: by how much out of reach, or which joint is in the way."""
    if isinstance(error, UnreachableError):
        where, to_do = ("too close", "further away") if error.too_close else ("out of reach", "closer")
        return f"{where} by {error.missing * 1e3:.0f} mm; move it {to_do}"
    if isinstance(error, PoseRangeError):
        return range_sentence(error.joint, error.value, robot)
    return str(error)
