"""Planning where nothing is in the way: what a plan carries, which requests are refused, settings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pydantic
import pytest
import yaml
from limit_use import limit_use
from planning_cell import (
    CHAIN,
    HOME,
    LEFT,
    QUICK,
    REQUEST,
    RIGHT,
    ROBOT,
    ROOT,
    SELF_COLLISION,
    WALL,
    Clock,
    planner,
    world,
)

from construction_twin.core.freshness import Moment
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import inverse_kinematics
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.robot.motion_errors import JointRangeError, PlanningError, TrajectoryError
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene

GOAL = HOME + np.array([0.9, 0.4, -0.5, 1.0, -0.6, 2.0])
EMPTY = world()


def test_free_motion_is_the_straight_line():
    plan = planner().plan_to_joints(HOME, GOAL, REQUEST, EMPTY)
    progress = (plan.trajectory.positions - HOME) / (GOAL - HOME)
    assert np.max(np.ptp(progress, axis=1)) < 1e-9
    assert plan.planner == "direct"
    assert plan.trajectory.positions[0].tobytes() == HOME.tobytes()
    assert plan.trajectory.positions[-1].tobytes() == GOAL.tobytes()


def test_a_plan_carries_what_was_asked_and_what_was_measured():
    request = PlanRequest("p9", Moment("c0ffee00", 11), source="replan after hold", duration=12.5, waypoints=300)
    plan = planner().plan_to_joints(HOME, GOAL, request, EMPTY)
    assert (plan.id, plan.asked, plan.source) == ("p9", Moment("c0ffee00", 11), "replan after hold")
    assert plan.hash == plan.trajectory.content_hash() and plan.scene == EMPTY.scene.hash
    assert len(plan.trajectory.times) == 300 and plan.trajectory.duration == 12.5
    assert 0.0 < max(plan.report.usage.velocity) < 1.0
    assert plan.report.clearance.distance > 0.0 and len(plan.report.clearance.between) == 2


def test_the_re_check_is_not_part_of_the_planning_time():
    plan = planner().plan_to_joints(HOME, GOAL, REQUEST, EMPTY)
    # on this clock every look takes 1 ms: at the beginning, around the re-check, at the end
    assert plan.report.recheck_time == pytest.approx(1e-3)
    assert plan.planning_time == pytest.approx(2e-3)


def test_the_planner_s_speed_scale_is_the_default():
    slow = planner(speed_scale=0.2).plan_to_joints(HOME, GOAL, REQUEST, EMPTY).trajectory
    asked = planner().plan_to_joints(HOME, GOAL, PlanRequest("p2", 0, speed_scale=0.2), EMPTY).trajectory
    assert slow.content_hash() == asked.content_hash()
    assert limit_use(slow, ROBOT).velocity <= 0.2


def test_a_duration_may_use_the_full_limits():
    fastest = planner().plan_to_joints(HOME, GOAL, PlanRequest("p1", 0, speed_scale=1.0), EMPTY).trajectory.duration
    by_default = planner(speed_scale=0.3).plan_to_joints(HOME, GOAL, REQUEST, EMPTY).trajectory.duration
    asked = 0.5 * (fastest + by_default)
    motion = planner(speed_scale=0.3).plan_to_joints(HOME, GOAL, PlanRequest("p1", 0, duration=asked), EMPTY).trajectory
    assert motion.duration == pytest.approx(asked, abs=1e-9)


@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_out_of_range_names_the_joint(end):
    outside = HOME + [0, 0, 0, 0, 0, 9.0]
    ends = (outside, GOAL) if end == "start" else (HOME, outside)
    with pytest.raises(JointRangeError, match="joint_a6"):
        planner().plan_to_joints(*ends, REQUEST, EMPTY)


@pytest.mark.parametrize("objects", [(), (WALL,)], ids=["direct", "search"])
def test_from_a_hair_outside_its_range_the_arm_comes_in(objects):
    robot = dataclasses.replace(ROBOT, lower=(RIGHT[0] + np.radians(0.04), *ROBOT.lower[1:]))
    made = Planner(robot, inverse_kinematics(Chain(robot)), PlannerSettings(**QUICK), Clock())
    cell = CollisionWorld(robot, Scene(objects, 0.01), SELF_COLLISION)
    pose = CHAIN.forward(LEFT)
    for plan in (made.plan_to_joints(RIGHT, LEFT, REQUEST, cell), made.plan_to_pose(RIGHT, pose, REQUEST, cell)):
        motion = plan.trajectory
        assert motion.positions[0].tobytes() == RIGHT.tobytes()
        a1 = motion.sample_many(np.arange(0.0, motion.duration, 0.004))[0][:, 0]
        came_in = int(np.argmax(a1 >= robot.lower[0]))
        assert np.all(np.diff(a1[: came_in + 1]) >= -1e-12) and np.all(a1[came_in:] >= robot.lower[0] - 1e-9)
    for ends in ((RIGHT - np.radians([0.02, 0, 0, 0, 0, 0]), LEFT), (LEFT, RIGHT)):
        with pytest.raises(JointRangeError, match="joint_a1"):
            made.plan_to_joints(*ends, REQUEST, cell)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_the_limits_themselves_can_be_reached_and_left(joint, side):
    limit = HOME.copy()
    limit[joint] = getattr(ROBOT, side)[joint]
    if EMPTY.is_free(limit):
        there = planner().plan_to_joints(HOME, limit, REQUEST, EMPTY).trajectory
        back = planner().plan_to_joints(limit, HOME, REQUEST, EMPTY).trajectory
        assert there.positions[-1].tobytes() == back.positions[0].tobytes() == limit.tobytes()
    else:
        with pytest.raises(PlanningError, match="touches"):
            planner().plan_to_joints(HOME, limit, REQUEST, EMPTY)


def test_a_wrong_number_of_joints_is_refused():
    with pytest.raises(PlanningError, match="goal has 5 values; expected 6"):
        planner().plan_to_joints(HOME, GOAL[:5], REQUEST, EMPTY)


def test_nan_is_out_of_range():
    with pytest.raises(JointRangeError, match="joint_a1 is nan"):
        planner().plan_to_joints(HOME, GOAL * np.nan, REQUEST, EMPTY)


def test_already_there_is_said():
    with pytest.raises(TrajectoryError, match="the arm is already there"):
        planner().plan_to_joints(HOME, HOME, REQUEST, EMPTY)


def test_a_pose_is_reached_by_its_nearest_solution():
    target = CHAIN.forward(GOAL)
    plan = planner().plan_to_pose(HOME, target, REQUEST, EMPTY)
    reached = CHAIN.forward(plan.trajectory.positions[-1])
    np.testing.assert_allclose(reached.position, target.position, atol=1e-6)
    np.testing.assert_allclose(reached.rotation, target.rotation, atol=1e-6)
    assert plan.trajectory.positions[0].tobytes() == HOME.tobytes()
    assert np.linalg.norm(plan.trajectory.positions[-1] - HOME) <= np.linalg.norm(GOAL - HOME) + 1e-6


@pytest.mark.parametrize(
    "changes",
    [
        dict(planner="Magic"),
        dict(planning_budget=0.0),
        dict(speed_scale=1.5),
        dict(seed=0),
        dict(speed=1.0),
        dict(goals=0),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes):
    with pytest.raises(pydantic.ValidationError):
        PlannerSettings(**(QUICK | changes))


def test_the_shipped_configuration_has_every_setting():
    shipped = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
    PlannerSettings(**{key: value for key, value in shipped.items() if key in PlannerSettings.model_fields})
    assert set(PlannerSettings.model_fields) <= set(shipped)
