"""The KR 120 on its track: the nearest position, checked by a dense search; rates along the axis; a choice of positions."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import pytest
from dense_search import dense_search
from hypothesis import given, settings
from ik_figures import NEARER, problems
from inverse_cases import TRACK, assert_solves, changed, joints, make_inverse

from construction_twin.core.freshness import Moment
from construction_twin.core.motion_errors import CollisionError
from construction_twin.kinematics.closed_form import SLOTS, ClosedFormInverse
from construction_twin.kinematics.inverse import IkSettings
from construction_twin.kinematics.rail import find_rail
from construction_twin.kinematics.rail_intervals import make_intervals, make_node
from construction_twin.kinematics.rail_rates import AT_EDGE, RailRates
from construction_twin.kinematics.rail_samples import RailSampler
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import sample_self_collision

RAIL = make_inverse(TRACK)
SEARCH = dense_search(RAIL.chain)
CARRIAGE, MODEL = find_rail(RAIL.chain)
ARM = ClosedFormInverse(CARRIAGE.arm, MODEL, IkSettings())
#: The track and the arm's model have the same directions.
TRAVEL = np.array([1.0, 0.0, 0.0])
ALONG = RailRates(ARM.model, TRAVEL)
SAMPLER = RailSampler(ARM, TRAVEL, TRACK.lower[0], TRACK.upper[0])
#: Of the first 1000 problems drawn from a number, those whose nearest solution lies where only a fine division finds it: in a wrist
#: that turns over within millimetres, where a range ends twice within centimetres, at an edge of the reach, or with a turn that is
#: in range only between two positions.
HARD = ((1, (91, 240, 262, 290, 511, 658, 726, 754, 755, 827)), (77, (231, 295, 968)))


def flange_at(q) -> np.ndarray:
    """Return the target that joint values reach, as the arm sees it with the carriage at zero."""
    flange = ARM.flange(ARM.chain.forward(q[1:]))
    flange[0, 3] += q[0]
    return flange


def branch_at(flange: np.ndarray, position: float, slot: int) -> np.ndarray:
    return ARM.branches((flange - position * np.outer([*TRAVEL, 0.0], [0.0, 0.0, 0.0, 1.0]))[None]).q[0, slot]


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


@given(joints(TRACK))
@settings(max_examples=100, deadline=None)
def test_rates_are_what_joints_turn_by(q):
    flange, step = flange_at(q), 1e-6
    for slot in range(len(SLOTS)):
        before, here, after = (branch_at(flange, q[0] + part * step, slot) for part in (-1.0, 0.0, 1.0))
        rates = np.array(ALONG.rates(here))
        turned = after - before
        turned -= 2.0 * math.pi * np.rint(turned / (2.0 * math.pi))
        # beside a singularity rates change within the step; where the wrist is stretched the branch flips
        wrist = abs(math.sin(here[4] - ARM.model.signs[4] * ARM.model.offsets[4]))
        if np.isfinite(turned).all() and np.abs(rates).max() < 100.0 and wrist > 1e-3:
            np.testing.assert_allclose(turned / (2.0 * step), rates, atol=1e-2)


def test_at_the_edges_of_the_reach_branches_end():
    found = 0
    for q in np.random.default_rng(4).uniform(TRACK.lower, TRACK.upper, (40, 7)):
        flange = flange_at(q)
        for edge in ALONG.steep_positions(flange)[0]:
            inside, one, other = (
                [np.isfinite(branch_at(flange, edge + away, slot)[0]) for slot in (0, 2)]
                for away in (0.0, -10.0 * AT_EDGE, 10.0 * AT_EDGE)
            )
            # of one shoulder, on one side; the other one's reach has other edges
            assert [each for each in range(2) if inside[each] and one[each] != other[each]]
            found += 1
    assert found > 40


def test_the_bound_of_an_interval_holds_within_it():
    checked = 0
    for task in problems(RAIL.chain, 40, 8):
        flange = flange_at(RAIL.nearest(task.pose, task.seed).q)
        samples = SAMPLER.sample(flange, float(task.seed[0]), np.ones(len(SLOTS), dtype=bool))
        aim = SAMPLER.aim(task.seed)
        measured = SAMPLER.measure(samples, aim)
        for column in np.flatnonzero(samples.joined[1:-1])[::7].tolist():
            ends = [SAMPLER.sample_node(samples, measured, each, False, aim) for each in (column, column + 1)]
            slot = column // len(samples.positions)
            for interval in make_intervals(*ends, aim, SAMPLER.straight(aim), samples.edges_known):
                first, last = interval.first, interval.last
                if last.away[0] - first.away[0] < 1e-6:
                    continue  # one position
                bound = min(max(interval.bound, 0.0), first.square, last.square)
                for part in np.linspace(0.0, 1.0, 12):
                    expected = [a + part * (b - a) for a, b in zip(first.away, last.away)]
                    node, _ = SAMPLER.node(flange, task.seed[0] + expected[0], slot, expected, aim)
                    if node.excess <= 0.0:
                        assert math.sqrt(node.square) >= math.sqrt(bound) - 1e-3
                        checked += 1
    assert checked > 1000


def test_a_node_knows_the_joint_that_is_out_of_range():
    aim = SAMPLER.aim(np.array(TRACK.home))
    away = [0.0, 0.1, aim.low[1] - 0.3, 0.0, 0.0, aim.high[4] + 0.2, 0.0]
    node = make_node(away, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], aim)
    assert node.excess == pytest.approx(0.3) and node.outwards == -2.0
    assert node.square == pytest.approx(sum(value**2 for value in away))
    assert node.slope == pytest.approx(2.0 * sum(value * rate for value, rate in zip(away, node.rates)))
    assert make_node([math.nan] * 7, [math.nan] * 6, aim).excess == math.inf


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
    budget = PlannerSettings(
        planner="RRTConnect",
        planning_budget=5.0,
        edge_step=0.1,
        speed_scale=1.0,
        max_waypoints=2000,
        max_duration=600.0,
        seed=1,
    )
    return Planner(TRACK, RAIL, budget, time.monotonic)


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
    travel = inverse.chain.jacobian(TRACK.home)[:3, 0]
    along = RailRates(ARM.model, travel)
    for task in problems(inverse.chain, 12, 3):
        solution = inverse.nearest(task.pose, task.seed)
        assert_solves(inverse.chain, solution, task.pose, task.seed)
        assert solution.distance <= search(task) + NEARER
        # along the self-motion the tip stands still
        rates = [1.0, *along.rates(solution.q[1:].tolist())]
        if np.abs(rates).max() < 100.0:
            assert np.abs(inverse.chain.jacobian(solution.q) @ rates).max() < 1e-9
