"""Requests without measure: refused before anything of their size is made, and always answered."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from planning_cell import CHAIN, HOME, LEFT, QUICK, REQUEST, RIGHT, ROBOT, SELF_COLLISION, Clock, solver

from construction_twin.extensions.planners.waypoint_file import read_waypoints
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.cartesian import FarWaypointError
from construction_twin.planning.ik_branch import CartesianPathError
from construction_twin.planning.pipeline import NoSceneError, PlanningPipeline
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.request_limits import PlanSizeError
from construction_twin.planning.timing import time_path
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.waypoints import from_points
from construction_twin.robot.motion_errors import PlanningError
from construction_twin.scene.objects import Scene

START = CHAIN.forward(HOME)
EMPTY = Scene(padding=0.01)


def pipeline(**changes) -> PlanningPipeline:
    made = PlanningPipeline(
        ROBOT,
        solver(),
        PlannerSettings(**(QUICK | changes)),
        SELF_COLLISION,
        Clock(),
        "/scene",
    )
    made.set_scene(EMPTY)
    return made


def to(*offset, **more) -> ToolWaypoint:
    return ToolWaypoint(Pose(START.position + np.array(offset), START.rotation), **more)


@pytest.mark.parametrize(
    "change",
    [{"duration": 1e9}, {"duration": 601.0}, {"duration": 1e300}]
    + [{"speed_scale": scale} for scale in (1e-9, 1e-100, 1e-300)]
    + [{"acceleration_scale": scale} for scale in (1e-12, 1e-100, 1e-300)],
)
@pytest.mark.parametrize("curved", [False, True])
def test_a_motion_that_takes_too_long_is_refused_before_it_is_made(change, curved):
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"), pytest.raises(PlanningError) as caught:
        if curved and "duration" not in change:
            waypoints = from_points(ROBOT, ROBOT.joint_names, [RIGHT, HOME, LEFT])
            pipeline().through(RIGHT, waypoints, replace(REQUEST, **change))
        else:
            pipeline().to_joints(HOME, LEFT, replace(REQUEST, **change))
    if not isinstance(caught.value, PlanSizeError):
        assert "cannot be timed" in str(caught.value)
    else:
        assert (caught.value.quantity, caught.value.limit) == ("duration", 600.0)


def test_a_plan_up_to_the_bounds_is_made():
    plan = pipeline(max_duration=30.0, max_waypoints=1501).to_joints(HOME, LEFT, replace(REQUEST, duration=30.0))
    assert plan.trajectory.duration == 30.0 and len(plan.trajectory.times) == 1501


def test_waypoints_that_nobody_counted_count():
    with pytest.raises(
        PlanSizeError,
        check=lambda error: (error.quantity, error.value, error.limit) == ("waypoints", 1501, 1500),
    ):
        pipeline(max_waypoints=1500).to_joints(HOME, LEFT, replace(REQUEST, duration=30.0))
    rows = [RIGHT + (LEFT - RIGHT) * fraction for fraction in np.linspace(0.0, 1.0, 30)]
    for times in (None, list(np.linspace(0.0, 30.0, 30))):
        with pytest.raises(PlanSizeError, check=lambda error: error.quantity == "waypoints"):
            pipeline(max_waypoints=29).through(RIGHT, from_points(ROBOT, ROBOT.joint_names, rows, times=times), REQUEST)
    with pytest.raises(PlanSizeError, check=lambda error: error.quantity == "waypoints"):
        pipeline(max_waypoints=20).along(HOME, [to(0.3, 0.0, 0.0)], 0.2, REQUEST)
    with pytest.raises(PlanSizeError, check=lambda error: error.quantity == "waypoints"):
        pipeline(max_waypoints=30).along(
            HOME, [to(0.1 * (number % 2), 0.0, 0.0) for number in range(1, 5)], None, REQUEST
        )


@pytest.mark.parametrize("end", [601.0, 1e7, 2e9])
def test_timed_waypoints_that_take_too_long_are_refused(end):
    points = from_points(ROBOT, ROBOT.joint_names, [HOME, LEFT], times=[0.0, end])
    with pytest.raises(PlanSizeError, check=lambda error: error.quantity == "duration"):
        pipeline().through(HOME, points, REQUEST)


@pytest.mark.parametrize("speed", [1e-9, 1e-300])
def test_a_tool_that_creeps_is_refused(speed):
    with pytest.raises(PlanSizeError, check=lambda error: error.quantity == "duration"):
        pipeline().along(HOME, [to(0.1, 0.0, 0.0)], speed, REQUEST)


def test_a_tool_path_of_kilometres_is_refused_before_it_is_followed():
    back_and_forth = [to(1.0 * (number % 2), 0.0, 0.0) for number in range(1, 200)]
    with pytest.raises(PlanSizeError, match="length of the tool's path would be 199000 mm; .* at most 100000 mm,"):
        pipeline().along(HOME, back_and_forth, None, REQUEST)


ALMOST_STRAIGHT = to(0.2, 0.0, 0.0, via=START.position + np.array([0.3, 1e-5, 0.0]))


@pytest.mark.parametrize(
    "path, what",
    [
        ([to(1e5, 0.0, 0.0)], "waypoint 0: its position is 10000[0-9]+ mm"),
        ([to(0.1, 0.0, 0.0), to(1e12, 0.0, 0.0)], "waypoint 1: its position"),
        ([to(1e300, 0.0, 0.0)], "its position"),
        ([to(0.1, 0.0, 0.0, via=START.position + np.array([1e6, 1e6, 0.0]))], "the via point of its arc is 1.41421e"),
        ([to(0.1, 0.1, 0.0),
          replace(ALMOST_STRAIGHT, pose=to(0.3, 0.3, 0.0).pose, via=START.position + np.array([0.5, 0.5001, 0]))],
         "waypoint 1: the arc that leads there"),
        ([ALMOST_STRAIGHT], "waypoint 0: the arc that leads there"),
    ],
)  # fmt: skip
def test_a_place_far_beyond_the_arm_is_refused_at_once(path, what):
    with pytest.raises(FarWaypointError, match=what) as caught:
        pipeline().along(HOME, path, 0.2, REQUEST)
    assert caught.value.distance > 2.0 * caught.value.reach == 2.0 * CHAIN.reach


def test_a_corner_that_is_too_sharp_asks_for_a_larger_blend():
    with pytest.raises(CartesianPathError, match="give the corner a larger blend"):
        pipeline().along(HOME, [to(0.1, 0.0, 0.0, blend=1e-9), to(0.1, 0.1, 0.0)], 0.2, REQUEST)


def test_a_corner_at_which_every_joint_turns_or_stops_is_timed():
    lower, upper = np.array(ROBOT.lower), np.array(ROBOT.upper)
    path = np.array([lower, lower, lower])
    path[1:, 3] = upper[3]
    path[2, 1] = 0.5 * (lower[1] + upper[1])
    motion = time_path(path, ROBOT)
    assert motion.duration < 10.0
    assert np.min(np.max(np.abs(motion.positions - path[1]), axis=1)) < 0.05


# -- files


def test_a_pipe_a_device_and_a_huge_file_are_not_read(tmp_path):
    pipe, huge = tmp_path / "pipe", tmp_path / "huge.csv"
    os.mkfifo(pipe)
    with open(huge, "wb") as file:
        file.truncate(2**30)
    for path, what in ((pipe, "not a regular file"), ("/dev/zero", "not a regular file"), (huge, "larger than 16 MiB")):
        with pytest.raises(PlanningError, match=what):
            read_waypoints(str(path), ROBOT)
    with pytest.raises(PlanningError, match="cannot be read:"):
        read_waypoints("/tmp/\0.csv", ROBOT)


def test_a_scene_that_came_meanwhile_is_not_forgotten():
    made = pipeline()
    seen = made.scene
    made.set_scene(Scene(padding=0.01))
    made.forget_scene(seen)
    made.wait_for_scene(0.0)
    made.forget_scene(made.scene)
    with pytest.raises(NoSceneError):
        made.wait_for_scene(0.0)
