"""Planning: OMPL paths, validity, goals as joints and as poses, and how failures read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pydantic
import pytest
import yaml

from construction_twin.errors import (
    DurationError,
    JointRangeError,
    NoPathError,
    PlanningError,
    TrajectoryError,
    UnreachableError,
)
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.planning.planner import PLANNERS, Planner, PlannerSettings, PlanRequest
from construction_twin.robot import read_robot_files
from construction_twin.planning.timing import limit_use

ROOT = Path(__file__).parents[2]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
CHAIN = Chain(ROBOT)
HOME = np.array(ROBOT.home)
GOAL = HOME + np.array([0.9, 0.4, -0.5, 1.0, -0.6, 2.0])
REQUEST = PlanRequest(plan_id="p1", created_ns=7)
QUICK = dict(
    planner="RRTConnect",
    planning_budget=0.5,
    simplify_budget=0.1,
    ik_budget=0.2,
    speed_scale=0.5,
    max_waypoints=2000,
    seed=1,
)


class Clock:
    """Advances 1 ms a call."""

    def __init__(self):
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 1e-3
        return self.now


def planner(is_valid=None, **changes) -> Planner:
    return Planner(ROBOT, CHAIN, PlannerSettings(**(QUICK | changes)), Clock(), is_valid)


def no_wall(q: np.ndarray) -> bool:
    """A wall that the straight line from HOME to GOAL crosses, with room above it."""
    return not (0.4 < q[0] < 0.5 and q[1] < -0.9)


def test_free_motion_is_the_straight_line():
    plan = planner().plan_to_joints(HOME, GOAL, REQUEST)
    progress = (plan.trajectory.positions - HOME) / (GOAL - HOME)
    assert np.max(np.ptp(progress, axis=1)) < 1e-9
    assert plan.trajectory.positions[0].tobytes() == HOME.tobytes()
    assert plan.trajectory.positions[-1].tobytes() == GOAL.tobytes()


def test_a_plan_carries_what_was_asked_and_what_identifies_it():
    request = PlanRequest("p9", 11, source="replan after hold", duration=12.5, waypoints=300)
    plan = planner().plan_to_joints(HOME, GOAL, request)
    assert (plan.id, plan.created_ns, plan.source, plan.planner) == ("p9", 11, "replan after hold", "RRTConnect")
    assert plan.hash == plan.trajectory.content_hash()
    assert len(plan.trajectory.times) == 300 and plan.trajectory.duration == 12.5
    assert plan.planning_time == pytest.approx(1e-3)  # measured on the clock that was given


def test_the_planner_s_speed_scale_is_the_default():
    slow = planner(speed_scale=0.2).plan_to_joints(HOME, GOAL, REQUEST).trajectory
    asked = planner().plan_to_joints(HOME, GOAL, PlanRequest("p2", 0, speed_scale=0.2)).trajectory
    assert slow.content_hash() == asked.content_hash()
    assert limit_use(slow, ROBOT).velocity <= 0.2


def test_a_duration_may_use_the_full_limits():
    fastest = planner().plan_to_joints(HOME, GOAL, PlanRequest("p1", 0, speed_scale=1.0)).trajectory.duration
    by_default = planner().plan_to_joints(HOME, GOAL, REQUEST).trajectory.duration
    asked = 0.5 * (fastest + by_default)
    motion = planner().plan_to_joints(HOME, GOAL, PlanRequest("p1", 0, duration=asked)).trajectory
    assert motion.duration == pytest.approx(asked, abs=1e-9)


@pytest.mark.parametrize("name", PLANNERS)
def test_every_planner_goes_round_an_obstacle(name):
    plan = planner(no_wall, planner=name).plan_to_joints(HOME, GOAL, REQUEST)
    motion = plan.trajectory
    assert plan.planner == name
    assert all(no_wall(q) for q in motion.sample_many(np.arange(0.0, motion.duration, 0.004))[0])
    assert motion.positions[0].tobytes() == HOME.tobytes() and motion.positions[-1].tobytes() == GOAL.tobytes()
    assert limit_use(motion, ROBOT).velocity <= 0.5


def test_no_path_is_said_within_the_budget():
    with pytest.raises(NoPathError, match="RRTConnect found no path within 0.1 s"):
        planner(lambda q: not 0.4 < q[0] < 0.5, planning_budget=0.1).plan_to_joints(HOME, GOAL, REQUEST)


def test_an_invalid_end_is_named():
    with pytest.raises(PlanningError, match="the goal .* not allowed"):
        planner(lambda q: q[0] < 0.5).plan_to_joints(HOME, GOAL, REQUEST)
    with pytest.raises(PlanningError, match="the start .* not allowed"):
        planner(lambda q: q[0] > 0.5).plan_to_joints(HOME, GOAL, REQUEST)


@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_out_of_range_names_the_joint(end):
    outside = HOME + [0, 0, 0, 0, 0, 9.0]
    ends = (outside, GOAL) if end == "start" else (HOME, outside)
    with pytest.raises(JointRangeError, match="joint_a6"):
        planner().plan_to_joints(*ends, REQUEST)


@pytest.mark.parametrize("limits", [ROBOT.lower, ROBOT.upper])
def test_the_limits_themselves_can_be_reached_and_left(limits):
    there = planner().plan_to_joints(HOME, limits, REQUEST).trajectory
    back = planner().plan_to_joints(limits, HOME, REQUEST).trajectory
    assert tuple(there.positions[-1]) == tuple(back.positions[0]) == limits


def test_a_wrong_number_of_joints_is_refused():
    with pytest.raises(PlanningError, match="goal has 5 values; expected 6"):
        planner().plan_to_joints(HOME, GOAL[:5], REQUEST)


def test_nan_is_out_of_range():
    with pytest.raises(JointRangeError, match="joint_a1 is nan"):
        planner().plan_to_joints(HOME, GOAL * np.nan, REQUEST)


def test_already_there_is_said():
    with pytest.raises(TrajectoryError, match="already there"):
        planner().plan_to_joints(HOME, HOME, REQUEST)


def test_too_many_waypoints_are_refused():
    with pytest.raises(PlanningError, match="2001 waypoints .* at most 2000"):
        planner().plan_to_joints(HOME, GOAL, PlanRequest("p1", 0, waypoints=2001))


def test_too_short_a_duration_passes_through():
    with pytest.raises(DurationError):
        planner().plan_to_joints(HOME, GOAL, PlanRequest("p1", 0, duration=0.1))


def test_a_pose_is_reached():
    target = CHAIN.forward(GOAL)
    plan = planner().plan_to_pose(HOME, target, REQUEST)
    reached = CHAIN.forward(plan.trajectory.positions[-1])
    np.testing.assert_allclose(reached.position, target.position, atol=1e-6)
    np.testing.assert_allclose(reached.rotation, target.rotation, atol=1e-6)
    assert plan.trajectory.positions[0].tobytes() == HOME.tobytes()


def test_an_unreachable_pose_passes_through():
    with pytest.raises(UnreachableError):
        planner().plan_to_pose(HOME, Pose(np.array([9.0, 0.0, 1.0]), np.eye(3)), REQUEST)


def test_nothing_is_printed(capfd):
    planner(no_wall).plan_to_joints(HOME, GOAL, REQUEST)
    with pytest.raises(NoPathError):
        planner(lambda q: not 0.4 < q[0] < 0.5, planning_budget=0.05).plan_to_joints(HOME, GOAL, REQUEST)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "changes", [dict(planner="Magic"), dict(planning_budget=0.0), dict(speed_scale=1.5), dict(seed=-1), dict(speed=1.0)]
)
def test_settings_that_make_no_sense_are_refused(changes):
    with pytest.raises(pydantic.ValidationError):
        PlannerSettings(**(QUICK | changes))


def test_the_shipped_configuration_has_every_setting():
    shipped = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
    PlannerSettings(**{key: value for key, value in shipped.items() if key in PlannerSettings.model_fields})
    assert set(PlannerSettings.model_fields) <= set(shipped)
