"""Plans for tests: a trajectory in everything that a planner adds to it."""

from __future__ import annotations

import math

from construction_twin.core.freshness import Moment
from construction_twin.robot.plan import Clearance, LimitUsage, Plan, PlanReport
from construction_twin.robot.trajectory import Trajectory

#: Which clock the moments of tests are of.
ROBOT_CLOCK = "c0ffee00"


def make_report(joints: int) -> PlanReport:
    """Return what would be measured where there is nothing to touch; the fractions differ from joint to joint."""
    fractions = [tuple(scale * (joint + 1) / joints for joint in range(joints)) for scale in (0.5, 0.6, 0.7)]
    return PlanReport(Clearance(math.inf), LimitUsage(*fractions), 0.01)


def make_plan(trajectory: Trajectory, plan_id: str = "p", scene: str = "s", asked_ns: int = 0) -> Plan:
    """Return a plan for a trajectory, as if checked against the scene with hash `scene`, asked for at `asked_ns`."""
    return Plan(
        id=plan_id,
        hash=trajectory.content_hash(),
        source="test",
        planner="none",
        scene=scene,
        asked=Moment(ROBOT_CLOCK, asked_ns),
        planning_time=0.0,
        trajectory=trajectory,
        report=make_report(len(trajectory.joint_names)),
    )
