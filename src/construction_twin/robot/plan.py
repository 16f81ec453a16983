"""A plan for review: a trajectory, its origin, and what was measured on it before a reviewer sees it.

SI; joint tuples in the order of the trajectory's `joint_names`; points in the robot's base frame.
"""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.freshness import Moment
from construction_twin.robot.motion_errors import TrajectoryError
from construction_twin.robot.segments import Segment, check_segments, segments_hash
from construction_twin.robot.trajectory import Trajectory

#: How the source of a plan begins that a client of the action FollowJointTrajectory asked for; its node's name follows.
BY_ACTION = "follow_joint_trajectory from"


@dataclass(frozen=True)
class Clearance:
    """Smallest distance between two bodies that must not touch, and when on a trajectory it occurs [s].

    Attributes:
        distance: [m]; negative: the penetration depth. inf: there is nothing to touch.
        between: A link of the robot first, then a link or an object of the scene; or none.
        point: Nearest point on the first of them, in the robot's base frame [m].
    """

    distance: float
    between: tuple[str, ...] = ()
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time: float = 0.0


@dataclass(frozen=True)
class LimitUsage:
    """Largest fraction of each joint's limit that a trajectory uses, over all 4 ms samples; 1 is exactly at the limit."""

    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]


@dataclass(frozen=True)
class PlanReport:
    """What was measured on every 4 ms sample of a trajectory, which took `recheck_time` [s]."""

    clearance: Clearance
    usage: LimitUsage
    recheck_time: float


@dataclass(frozen=True)
class Plan:
    """A trajectory with its origin, as a reviewer sees it. The constructor refuses a hash that is not that of its content.

    Attributes:
        hash: The trajectory's `content_hash`; of a work plan: `segments_hash`.
        planner: How the path was found: name of an OMPL planner, ``direct``, ``cartesian``, ``waypoints``, ``work``, ``way back``.
        scene: Hash of the scene it was checked against.
        asked: When it was asked for: a stop after that voids it.
        planning_time: Time spent planning and timing [s], without `PlanReport.recheck_time`.
        retimed: Why the times that were asked for were replaced, as one sentence; empty: they were kept, or there were none.
        task: Id of the task that a work plan carries out.
        segments: Of a work plan; empty: the trajectory is one motion in one scene.
    """

    id: str
    hash: str
    source: str
    planner: str
    scene: str
    asked: Moment
    planning_time: float
    trajectory: Trajectory
    report: PlanReport
    retimed: str = ""
    task: str = ""
    segments: tuple[Segment, ...] = ()

    def __post_init__(self):
        if not self.id:
            raise TrajectoryError("a plan has an empty id; expected a unique one")
        check_segments(self.id, self.scene, self.trajectory.duration, self.segments)
        found = content_hash(self.trajectory, self.task, self.segments)
        if self.hash != found:
            raise TrajectoryError(f"plan {self.id} has hash '{self.hash}', its content has {found}; plan it again")


def content_hash(trajectory: Trajectory, task: str = "", segments: tuple[Segment, ...] = ()) -> str:
    """Return the hash that a plan's approval covers: of the trajectory, and of a work plan's task and segments."""
    found = trajectory.content_hash()
    return segments_hash(found, task, segments) if segments or task else found
