"""A plan for review: a trajectory, its origin, and what was measured on it; points in the robot's base frame."""

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
    """Smallest distance between two bodies that must not touch [m], inf: none, and when on a trajectory it occurs [s].

    `point` is the nearest one on the first of `between`, a link of the robot; a negative distance is the penetration depth.
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
    """A trajectory with its origin, as a reviewer sees it; refuses a hash that is not that of its content.

    Attributes:
        hash: See `content_hash`.
        planner: Name of an OMPL planner, ``direct``, ``cartesian``, ``waypoints`` (with a note), ``work``, ``way back``.
        scene: Hash of the scene it was checked against.
        asked: A stop after this moment voids it.
        planning_time: Without `PlanReport.recheck_time` [s].
        retimed: Why its times are not those asked for; "": they are, or there were none.
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
