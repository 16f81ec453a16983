"""Planning around things: through a window, over a wall, to the branches that are free; seeds; what stays impossible."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from limit_use import limit_use
from planning_cell import CHAIN, HOME, LEFT, REQUEST, RIGHT, ROBOT, ROOT, WALL, bench_world, planner, solver, world

from construction_twin.planning.ompl_search import NoPathError, ompl_planners
from construction_twin.planning.planner import PlanRequest
from construction_twin.planning.recheck import CollisionError
from construction_twin.robot.motion_errors import PlanningError
from construction_twin.scene.objects import Scene, SceneObject

WALLED = world(WALL)
#: Planners that use their whole budget, or end without a path sooner than others.
OPTIMISING = {"RRTstar", "InformedRRTstar", "SORRTstar", "BITstar", "AORRTC", "PRM", "PRMstar", "FMT", "BFMT"}


def samples(plan, step: float) -> np.ndarray:
    times = np.append(np.arange(0.0, plan.trajectory.duration, step), plan.trajectory.duration)
    return plan.trajectory.sample_many(times)[0]


def skeleton_points(q: np.ndarray) -> np.ndarray:
    """Points every 1 % of the arm's centre line, by KDL."""
    line = CHAIN.skeleton(q)
    return np.concatenate([np.linspace(a, b, 100) for a, b in zip(line, line[1:])])


def test_the_straight_motion_is_blocked_and_the_plan_goes_around():
    plan = planner().plan_to_joints(RIGHT, LEFT, REQUEST, WALLED)
    assert WALLED.all_free(np.linspace(RIGHT, LEFT, 100)) is not None
    assert plan.planner == "RRTConnect"
    assert plan.report.clearance.distance >= 0.01  # the scene's padding
    assert WALLED.all_free(samples(plan, 0.001)) is None
    use = limit_use(plan.trajectory, ROBOT)
    assert use.velocity <= 1.0 and use.acceleration <= 1.0 and use.jerk <= 1.0
    assert plan.trajectory.positions[[0, -1]].tobytes() == np.array([RIGHT, LEFT]).tobytes()


def test_a_plan_reaches_through_the_window_and_does_not_touch_its_frame():
    near, through = HOME + np.radians([30, 0, 0, 0, 0, 0]), np.radians([0.0, -55.0, 65.0, 0.0, -10.0, 0.0])
    wall = bench_world("window")
    assert CHAIN.forward(near).position[0] < 1.4 and CHAIN.forward(through).position[0] > 1.8
    plan = planner().plan_to_joints(near, through, REQUEST, wall)
    assert wall.all_free(samples(plan, 0.001)) is None
    # by geometry alone: where the arm's centre line is inside the wall's thickness it is inside the opening, and further
    # from its edges than the thinnest link is thick
    crossed = 0
    for q in samples(plan, 0.02):
        points = skeleton_points(q)
        inside = points[np.abs(points[:, 0] - 1.55) < 0.05]
        crossed += len(inside) > 0
        assert np.all(np.abs(inside[:, 1]) < 0.6 - 0.08)
        assert np.all(np.abs(inside[:, 2] - 1.35) < 0.55 - 0.08)
    assert crossed > 5


def plan_with_growing_budget(name: str):
    """Those that use their whole budget get a short one first: how far they come in it is not known."""
    for budget in (0.5, 2.0, 8.0) if name in OPTIMISING else ():
        try:
            return planner(planner=name, planning_budget=budget).plan_to_joints(RIGHT, LEFT, REQUEST, WALLED)
        except NoPathError:
            continue
    return planner(planner=name, planning_budget=30.0).plan_to_joints(RIGHT, LEFT, REQUEST, WALLED)


@pytest.mark.parametrize("name", sorted(set(ompl_planners()) - {"RRT"}))
def test_every_planner_goes_round_an_obstacle(name):
    plan = plan_with_growing_budget(name)
    assert plan.planner == name
    assert WALLED.all_free(samples(plan, 0.004)) is None


def test_the_same_seed_gives_the_same_plan_in_one_process():
    first, second, other = planner(seed=5), planner(seed=5), planner(seed=6)
    hashes = [one.plan_to_joints(RIGHT, LEFT, REQUEST, WALLED).hash for one in (first, other, second, first, second)]
    assert len({hashes[0], *hashes[2:]}) == 1
    assert hashes[1] != hashes[0]


@pytest.mark.parametrize("end, q", [("start", RIGHT), ("goal", LEFT)])
def test_an_end_in_contact_names_the_pair_and_which_end(end, q):
    tool = CHAIN.forward(q).position
    blocked = world(SceneObject("post", "sphere", (0.15,), tuple(tool)))
    with pytest.raises(CollisionError, match=f"touches post \\(the {end}\\)") as caught:
        planner().plan_to_joints(RIGHT, LEFT, REQUEST, blocked)
    assert caught.value.between[1] == "post" and caught.value.where == f"the {end}"


def test_an_arm_folded_into_itself_is_no_goal():
    rng = np.random.default_rng(0)
    free = world()
    folded = next(q for q in rng.uniform(ROBOT.lower, ROBOT.upper, (5000, 6)) if not free.is_free(q))
    with pytest.raises(CollisionError, check=lambda error: error.between == ("link_1", "link_6")):
        planner().plan_to_joints(HOME, folded, REQUEST, free)


def test_the_nearest_branch_in_contact_gives_way_to_another():
    # a box on one side of the wrist: the two wrist branches of a pose hold it up, or down
    box = SceneObject("box", "box", (0.1, 0.1, 0.1), (-0.1, 0.0, 0.3), link="link_4", touch=("link_3", "link_5"))
    target = CHAIN.forward(LEFT)
    nearest, other = (one.q for one in solver().all(target, RIGHT)[:2])
    blocked = world(box, _ball_that_only_touches(box, nearest, [RIGHT, other]))
    plan = planner().plan_to_pose(RIGHT, target, REQUEST, blocked)
    goal = plan.trajectory.positions[-1]
    assert np.abs(goal - nearest).max() > 0.1
    np.testing.assert_allclose(CHAIN.forward(goal).position, target.position, atol=1e-6)
    assert blocked.all_free(samples(plan, 0.004)) is None


def _ball_that_only_touches(carried: SceneObject, q: np.ndarray, others: list[np.ndarray]) -> SceneObject:
    for offset in np.random.default_rng(0).normal(scale=0.3, size=(2000, 3)):
        ball = SceneObject("ball", "sphere", (0.05,), tuple(CHAIN.skeleton(q)[-3] + offset))
        tried = world(carried, ball)
        if not tried.is_free(q) and all(tried.is_free(other) for other in others):
            return ball
    raise AssertionError("no place for the ball")


def test_a_goal_that_every_branch_touches_names_what_is_there():
    target = CHAIN.forward(LEFT)
    blocked = world(SceneObject("post", "sphere", (0.2,), tuple(target.position)))
    with pytest.raises(CollisionError, check=lambda error: error.between[1] == "post" and error.where == "the goal"):
        planner().plan_to_pose(HOME, target, REQUEST, blocked)


def test_a_fixed_configuration_is_kept():
    target = CHAIN.forward(LEFT)
    inverse = solver()
    configurations = {str(one.configuration) for one in inverse.all(target, HOME) if WALLED.is_free(one.q)}
    assert len(configurations) > 1
    for text in configurations:
        plan = planner().plan_to_pose(RIGHT, target, REQUEST, WALLED, text)
        assert str(inverse.configuration(plan.trajectory.positions[-1])) == text


#: Through the arm's axis, with room for its column only.
APART = (
    SceneObject("front", "box", (3.0, 0.1, 5.0), (2.2, 0.0, 2.5)),
    SceneObject("back", "box", (3.0, 0.1, 5.0), (-2.2, 0.0, 2.5)),
    SceneObject("above", "box", (6.0, 0.1, 3.0), (0.0, 0.0, 3.1)),
)


@pytest.mark.parametrize("name", sorted(ompl_planners()))
def test_every_planner_ends_where_none_of_several_goals_can_be_reached(name):
    side, other = (HOME + np.radians([turn, 45, -20, 0, 20, 0]) for turn in (-90, 90))
    walls, pose = world(*APART), CHAIN.forward(other)
    assert sum(walls.is_free(one.q) for one in solver().all(pose, side)) > 1
    # BFMT has tried everything before
    budget = 8.0 if name == "BFMT" else 0.5
    with pytest.raises(NoPathError):
        planner(planner=name, planning_budget=budget).plan_to_pose(side, pose, REQUEST, walls)


def test_no_path_says_how_long_was_tried():
    side, other = (HOME + np.radians([turn, 45, -20, 0, 0, 0]) for turn in (-90, 90))
    with pytest.raises(NoPathError, check=lambda error: error.planner == "RRTConnect") as caught:
        planner(planning_budget=0.3).plan_to_joints(side, other, REQUEST, world(*APART))
    assert caught.value.budget == pytest.approx(0.3, abs=0.01), "by the planner's clock"


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 99), st.integers(1, 2**31 - 1))
def test_any_plan_in_the_cell_is_free_and_within_the_limits(problem, seed):
    cell = bench_world("cluttered")
    row = np.loadtxt(ROOT / "benchmarks/problems/cluttered.csv", delimiter=",", skiprows=1)[problem]
    ends = row.reshape(2, 6)
    plan = planner(seed=seed).plan_to_joints(*ends, REQUEST, cell)
    # every 4 ms with the padding, in between without
    assert cell.all_free(samples(plan, 0.004)) is None
    assert cell.with_scene(Scene(cell.scene.objects, 0.0)).all_free(samples(plan, 0.0007)) is None
    use = limit_use(plan.trajectory, ROBOT)
    assert max(use.velocity, use.acceleration, use.jerk) <= 1.0 + 1e-9
    assert plan.trajectory.positions[[0, -1]].tobytes() == ends.tobytes()


def test_few_waypoints_that_leave_the_path_are_said():
    with pytest.raises(PlanningError, match="waypoints leave the path"):
        planner().plan_to_joints(RIGHT, LEFT, PlanRequest("p1", 0, waypoints=2), WALLED)
