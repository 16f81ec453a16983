"""The KR 120 on its track: the nearest position, checked by a dense search; a choice of positions."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import pytest
from dense_search import dense_search
from hypothesis import given, settings
from ik_figures import NEARER, Problem, problems
from inverse_cases import TRACK, assert_solves, changed, joints, make_inverse
from planning_cell import QUICK

from construction_twin.core.freshness import Moment
from construction_twin.kinematics.closed_form import SLOTS
from construction_twin.kinematics.rail import find_rail
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.planning.recheck import CollisionError
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import sample_self_collision

RAIL = make_inverse(TRACK)
SEARCH = dense_search(RAIL.chain)
CARRIAGE, MODEL = find_rail(RAIL.chain)
#: Of the first 1000 problems drawn from a number, those whose nearest solution lies where only a fine division finds it: in a wrist
#: that turns over within millimetres, where a range ends twice within centimetres, or at an edge of the reach.
HARD = ((1, (91, 240, 262, 290, 511, 658, 726, 827)), (77, (231, 295, 968)))


@pytest.mark.parametrize(("number", "rows"), HARD)
def test_nothing_is_nearer_where_it_is_hard_to_find(number, rows):
    tasks = problems(RAIL.chain, 1000, number)
    for row in rows:
        solution = RAIL.nearest(tasks[row].pose, tasks[row].seed)
        assert_solves(RAIL.chain, solution, tasks[row].pose, tasks[row].seed)
        assert solution.distance <= SEARCH(tasks[row]) + NEARER, row


def test_nothing_is_nearer_in_a_dense_search():
    for task in problems(RAIL.chain, 25, 5):
        found, dense = RAIL.nearest(task.pose, task.seed).distance, SEARCH(task)
        # the dense search finds real solutions, so it is not nearer either
        assert found == pytest.approx(dense, abs=NEARER)


@pytest.mark.parametrize("position", [0.123, -0.456])
def test_a_pose_in_reach_of_a_few_millimetres_of_the_track_alone_is_solved(position):
    # to the side, with the elbow bent by so little that 3 mm further along the track the arm does not reach it
    stretched = -math.atan2(MODEL.a2, MODEL.c3) + MODEL.signs[2] * MODEL.offsets[2]
    pose = RAIL.chain.forward([position, 0.5 * math.pi, -0.8, stretched + 1.5e-3, 0.5, 0.6, 0.7])
    solution = RAIL.nearest(pose, TRACK.home)
    assert_solves(RAIL.chain, solution, pose, TRACK.home)
    assert abs(solution.q[0] - position) < 0.01
    assert solution.distance <= SEARCH(Problem(pose, np.array(TRACK.home))) + NEARER


def test_a_start_near_the_goal_stays_near():
    rng = np.random.default_rng(9)
    for q in rng.uniform(np.array(TRACK.lower) + 0.06, np.array(TRACK.upper) - 0.06, (40, 7)):
        seed = q + rng.uniform(-0.05, 0.05, 7)
        assert RAIL.nearest(RAIL.chain.forward(q), seed).distance <= np.linalg.norm(seed - q) + 1e-6


def test_all_gives_positions_spaced_along_each_branch():
    q, home = np.array([0.3, 0.2, -1.4, 1.3, 0.4, 0.9, -0.2]), np.array(TRACK.home)
    pose = RAIL.chain.forward(q)
    solutions = RAIL.all(pose, home)
    for solution in solutions:
        assert_solves(RAIL.chain, solution, pose, home)
    one_branch = [solution for solution in solutions if solution.configuration == SLOTS[0]]
    near = [solution.q for solution in one_branch if np.abs(solution.q - home)[1:].max() < math.pi]
    positions = sorted(solution[0] for solution in near)
    # the branch is in range over most of the axis: nowhere is far from a solution
    assert len(positions) >= 4 and positions[-1] - positions[0] > 0.5
    for one, other in itertools.combinations(near, 2):
        assert np.linalg.norm(one - other) > 0.01
    assert [solution.distance for solution in solutions] == sorted(solution.distance for solution in solutions)


def planner_of_track() -> Planner:
    return Planner(TRACK, RAIL, PlannerSettings(**QUICK), time.monotonic)


def test_a_plan_goes_to_another_position_where_the_nearest_is_blocked():
    start = np.array(TRACK.home) + [0.95, 0, 0, 0, 0, 0, 0]
    pose = RAIL.chain.forward(np.array(TRACK.home) + [0.1, 0.5, 0.3, 0.2, 0.1, 0.2, 0.1])
    nearest = RAIL.nearest(pose, start)
    pairs = sample_self_collision(TRACK, samples=500)
    elbow = RAIL.chain.skeleton(nearest.q)[3]
    blocked = CollisionWorld(TRACK, Scene((SceneObject("ball", "sphere", (0.05,), tuple(elbow)),), 0.005), pairs)
    assert blocked.is_free(start) and not blocked.is_free(nearest.q)
    request = PlanRequest(plan_id="p1", asked=Moment("c0ffee00", 7))
    plan = planner_of_track().plan_to_pose(start, pose, request, blocked, str(nearest.configuration))
    reached = plan.trajectory.positions[-1]
    np.testing.assert_allclose(RAIL.chain.forward(reached).position, pose.position, atol=1e-5)
    assert RAIL.configuration(reached) == nearest.configuration
    assert blocked.is_free(reached) and abs(reached[0] - nearest.q[0]) > 0.02
    # every other whole turn at the nearest position touches the same ball
    assert np.abs(np.sin(0.5 * (reached - nearest.q)[1:])).max() > 0.01


def test_a_goal_that_touches_everywhere_is_refused():
    home = np.array(TRACK.home)
    pose = RAIL.chain.forward(home + [0.0, 0.3, 0.2, -0.1, 0.2, 0.1, 0.1])
    at_tool = SceneObject("post", "sphere", (0.1,), tuple(pose.position))
    world = CollisionWorld(TRACK, Scene((at_tool,), 0.005), sample_self_collision(TRACK, samples=500))
    with pytest.raises(CollisionError, match="post"):
        planner_of_track().plan_to_pose(home, pose, PlanRequest(plan_id="p1", asked=Moment("c0ffee00", 7)), world)


@pytest.mark.parametrize("axis", ["0 0 1", "0.6 0 0.8", "0.6 0.8 0"])
def test_the_axis_may_point_anywhere(axis):
    inverse = make_inverse(changed("track", axis=axis, robot=TRACK))
    search = dense_search(inverse.chain)
    for task in problems(inverse.chain, 12, 3):
        solution = inverse.nearest(task.pose, task.seed)
        assert_solves(inverse.chain, solution, task.pose, task.seed)
        assert solution.distance <= search(task) + NEARER


@given(joints(TRACK))
@settings(max_examples=50, deadline=None)
def test_the_arm_reaches_what_it_sees_from_its_carriage(q):
    seen, reached = CARRIAGE.target_from_carriage(RAIL.chain.forward(q), q[0]), CARRIAGE.arm.forward(q[1:])
    np.testing.assert_allclose(seen.matrix(), reached.matrix(), atol=1e-12)
