"""What the marker says of a pose is what the planner would say: same solutions, same contacts, for people."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_cases import SEARCHED, make_inverse
from planning_cell import CHAIN, HOME, ROBOT, WALL, solver, world

from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import OrientationError, UnreachableError
from construction_twin.robot.motion_errors import KinematicsError
from construction_twin.ros.nodes.tool_marker import COLOURS
from construction_twin.scene.objects import SceneObject
from construction_twin.views.reachability import Reach, judge_pose, out_reason

FLOOR = SceneObject("floor", "box", (20.0, 20.0, 1.0), (0.0, 0.0, -0.5))
FREE, WALLED = world(), world(WALL)
AT_HOME = CHAIN.forward(HOME)


def test_a_free_pose():
    verdict = judge_pose(AT_HOME, HOME, solver(), FREE)
    assert verdict.reach is Reach.FREE
    np.testing.assert_allclose(verdict.q, HOME, atol=1e-6)


def test_a_pose_out_of_reach_tells_by_how_much():
    far = Pose(AT_HOME.position + (3.0, 0.0, 0.0), AT_HOME.rotation)
    verdict = judge_pose(far, HOME, solver(), FREE)
    assert verdict.reach is Reach.OUT and verdict.q is None
    millimetres = int(verdict.sentence.removeprefix("out of reach by ").split()[0])
    assert 1500 < millimetres < 3000
    closer = Pose(far.position - 0.1 * (far.position - CHAIN.shoulder), far.rotation)
    assert int(judge_pose(closer, HOME, solver(), FREE).sentence.split()[4]) < millimetres - 200


def test_a_joint_in_the_way_is_named_with_its_range():
    lower, upper = ROBOT.lower[4], ROBOT.upper[4]
    text = out_reason(OrientationError("joint_a5", np.radians(150.0), lower, upper), ROBOT)
    low, high = (f"{np.degrees(end):.1f} deg" for end in (lower, upper))
    assert text == f"joint_a5 would have to be 150.0 deg; its range is {low} to {high}"


def test_too_close_is_another_advice():
    assert out_reason(UnreachableError(0.25, too_close=True), ROBOT) == "too close by 250 mm; move it further away"


def test_what_was_not_found_is_not_called_out_of_reach():
    hurried = make_inverse(SEARCHED, seeds=2, iterations=1)
    pose = hurried.chain.forward(np.radians([40, -60, 70, 30, 50, 20]))
    verdict = judge_pose(pose, SEARCHED.home, hurried, FREE)
    assert verdict.reach is Reach.UNKNOWN and verdict.q is None
    assert verdict.sentence == "no joint values found in 60 s; there may be some"
    assert COLOURS[Reach.UNKNOWN] != COLOURS[Reach.OUT]


def test_a_pose_in_the_floor_names_the_pair():
    low = Pose(np.array([1.6, 0.0, -0.1]), AT_HOME.rotation)
    verdict = judge_pose(low, HOME, solver(), world(FLOOR))
    assert verdict.reach is Reach.CONTACT and "floor" in verdict.between
    first, second = verdict.between
    assert verdict.sentence == f"{first} would touch {second}"


@settings(max_examples=30, deadline=None)
@given(st.tuples(*(st.floats(low, high) for low, high in zip(ROBOT.lower, ROBOT.upper))))
def test_free_means_a_solution_that_is_free(q):
    pose = CHAIN.forward(q)
    verdict = judge_pose(pose, HOME, solver(), WALLED)
    try:
        free = [s.q for s in solver().all(pose, HOME) if WALLED.is_free(s.q)]
    except KinematicsError:
        assert verdict.reach is Reach.OUT
        return
    assert (verdict.reach is Reach.FREE) == bool(free)
    if free:
        np.testing.assert_array_equal(verdict.q, free[0])


@pytest.mark.parametrize("position", [(np.nan, 0.0, 1.0), (np.inf, 0.0, 1.0)])
def test_no_pose_is_out(position):
    assert judge_pose(Pose(np.array(position), np.eye(3)), HOME, solver(), FREE).reach is Reach.OUT
