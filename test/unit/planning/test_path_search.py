"""Edges, rounded corners and OMPL's search: what is checked where, bounds, names, every arm."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning_cell import CHAIN, HOME, LEFT, QUICK, REQUEST, RIGHT, ROBOT, ROOT, WALL, planner, world

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.curves import rounded
from construction_twin.planning.motion_validator import CornerRounding, MotionValidator
from construction_twin.planning.ompl_search import NoPathError, OmplSearch, PathQuery, shortened
from construction_twin.planning.planner import Planner, PlannerSettings
from construction_twin.robot.description import read_robot_files
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import sample_self_collision

LEVERS = world().levers
BOUNDS = np.array(ROBOT.lower), np.array(ROBOT.upper)
PACE = np.array(ROBOT.velocity)
angles = st.floats(-3.0, 3.0)


class Recorder:
    """A world without contact, or with contact beyond an angle of the first joint; remembers what it was asked."""

    def __init__(self, most: float = np.inf):
        self.asked: list[np.ndarray] = []
        self._most = most

    def is_free(self, q) -> bool:
        self.asked.append(np.array(q))
        return q[0] <= self._most

    def all_free(self, qs) -> int | None:
        return next((row for row, q in enumerate(qs) if not self.is_free(q)), None)


@given(st.lists(angles, min_size=6, max_size=6), st.lists(angles, min_size=6, max_size=6), st.floats(0.02, 0.5))
def test_no_point_of_the_arm_moves_further_than_the_step_between_two_checks(start, end, step):
    recorder = Recorder()
    assert MotionValidator(recorder, LEVERS, step).free(np.array(start), np.array(end))
    along = sorted(recorder.asked, key=lambda q: np.linalg.norm(q - start))
    states = np.array([start, *along])
    np.testing.assert_allclose(states[-1], end, atol=1e-12)
    for first, second in list(zip(states, states[1:]))[:20]:
        assert np.max(np.linalg.norm(CHAIN.skeleton(first) - CHAIN.skeleton(second), axis=1)) <= step + 1e-9


def test_an_edge_of_no_length_checks_its_end():
    recorder = Recorder(most=-1.0)
    assert not MotionValidator(recorder, LEVERS, 0.1).free(HOME, HOME)
    assert len(recorder.asked) == 1


def test_a_linear_joint_moves_the_arm_by_what_it_moves():
    robot = read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml")
    found = CollisionWorld(robot, Scene((), 0.0), sample_self_collision(robot, samples=100)).levers
    assert found[robot.linear.index(True)] == pytest.approx(1.0)
    np.testing.assert_allclose(found[1:], LEVERS, rtol=0.02)


def test_the_levers_hold_for_every_point_of_the_arm_its_tool_and_its_load():
    bar = SceneObject("bar", "box", (4.0, 0.02, 0.02), (0.0, 0.0, 0.1), link="tool0")
    carrying = world(bar)
    assert (carrying.levers > LEVERS + 1.0).all()
    rng = np.random.default_rng(0)
    ends = np.array([[2.0, 0.0, 0.1], [-2.0, 0.0, 0.1], [0.0, 0.0, 0.0]])
    for q in rng.uniform(ROBOT.lower, ROBOT.upper, (300, 6)):
        for levers, points in ((carrying.levers, ends), (LEVERS, ends[2:])):
            step = rng.uniform(-0.2, 0.2, 6)
            before, after = CHAIN.forward(q), CHAIN.forward(q + step)
            moved = (points @ after.rotation.T + after.position) - (points @ before.rotation.T + before.position)
            assert np.linalg.norm(moved, axis=1).max() <= np.abs(step) @ levers


def test_a_corner_that_touches_is_tightened_and_others_are_not():
    # the second corner turns right below the contact: cutting it is free, cutting the first one is not
    path = np.zeros((4, 6))
    path[:, 0] = [0.0, -1.0, -1.0, 0.0]
    path[:, 1] = [0.0, 0.0, 1.0, 1.0]

    class Inside(Recorder):
        def is_free(self, q) -> bool:
            return not (q[0] > -0.97 and 0.02 < q[1] < 0.5)

    edges = MotionValidator(Inside(), np.ones(6), 0.01)
    assert edges.world.all_free(rounded(path, PACE, 1.0)(np.linspace(0.0, 1.0, 50))) is not None
    tight = CornerRounding(edges, PACE).tightened(path)
    curve = rounded(tight, PACE, 1.0)
    assert edges.world.all_free(curve(np.linspace(0.0, curve.length, 2000))) is None
    added = [q for q in tight if not any(np.array_equal(q, corner) for corner in path)]
    assert added and all(q[1] <= 0.5 for q in added)


def test_what_the_states_miss_a_look_between_them_finds():
    path = np.array([np.zeros(6), np.eye(6)[0], np.eye(6)[0] + np.eye(6)[1]])
    curve = rounded(path, PACE, 1.0)
    # a pin where the curve cuts the corner, half way between two states that are looked at
    pin = curve(np.array([0.475 * curve.length]))[0]

    class Pinned(Recorder):
        def is_free(self, q) -> bool:
            return np.linalg.norm(q - pin) > 0.002

        def first_contact(self, qs):
            finely = np.linspace(0.0, len(qs) - 1, 20 * len(qs))
            row = self.all_free([[np.interp(place, range(len(qs)), column) for column in qs.T] for place in finely])
            return None if row is None else (finely[row], ("arm", "pin"))

    edges = MotionValidator(Pinned(), np.ones(6), 0.02)
    np.testing.assert_array_equal(CornerRounding(edges, PACE).tightened(path), path)
    tight = rounded(CornerRounding(edges, PACE, between=True).tightened(path), PACE, 1.0)
    assert edges.world.all_free(tight(np.linspace(0.0, tight.length, 4000))) is None


def test_a_path_that_touches_by_itself_is_given_up():
    edges = MotionValidator(Recorder(most=0.5), np.ones(6), 0.05)
    path = np.array([np.zeros(6), np.eye(6)[0], np.eye(6)[0] + np.eye(6)[1]])
    rounding = CornerRounding(edges, PACE)
    assert rounding.tightened(path) is None
    assert rounding.tightened(path[:2]) is None
    np.testing.assert_array_equal(rounding.tightened(-path[:2]), -path[:2])


def test_a_path_begins_at_the_start_and_ends_at_one_of_the_goals():
    edges = MotionValidator(world(WALL), LEVERS, 0.02)
    goals = [LEFT + np.radians([0, 0, 0, 0, 0, turn]) for turn in (0, 90, -90)]
    path = OmplSearch("RRTConnect", time.monotonic).find(PathQuery(RIGHT, goals, edges, *BOUNDS, seed=3), 10.0)
    assert path[0].tobytes() == RIGHT.tobytes()
    assert path[-1].tobytes() in [goal.tobytes() for goal in goals]
    assert all(edges.free(a, b) for a, b in zip(path, path[1:]))
    assert np.max(np.abs(np.diff(path, axis=0)), axis=1).min() > 0.0


def test_a_path_that_only_the_coarse_check_calls_free_is_not_returned():
    class Thin(Recorder):
        """A sheet that a search with long steps jumps over, with a hole aside."""

        def is_free(self, q) -> bool:
            return not (0.5 < q[0] < 0.53 and abs(q[1]) < 0.6)

    class Asked(MotionValidator):
        """It notes by how many times longer steps it was asked to check."""

        def coarser(self, times: float) -> MotionValidator:
            asked.append(times)
            return super().coarser(times)

    asked: list[float] = []
    edges = Asked(Thin(), np.ones(6), 0.02)
    for seed in range(1, 31):
        query = PathQuery(np.zeros(6), [np.eye(6)[0]], edges, -2 * np.ones(6), 2 * np.ones(6), seed)
        path = OmplSearch("RRTConnect", time.monotonic).find(query, 5.0)
        assert all(edges.free(a, b) for a, b in zip(path, path[1:]))
    # where long steps jump over the sheet the shortcuts mostly mend it; where they do not, the search begins anew
    assert asked.count(1.0) >= 1 and len(asked) == 30 + asked.count(1.0)


def test_shortcuts_make_a_path_shorter_and_keep_its_ends_and_it_free():
    def free(first, second) -> bool:
        line = first + np.linspace(0.0, 1.0, 400)[:, None] * (second - first)
        return not np.any(np.linalg.norm(line, axis=1) < 1.0)

    path = np.array([[-2.0, 0.0], [-2.0, 3.0], [0.0, 3.0], [0.5, 2.0], [2.0, 3.0], [2.0, 0.0]])
    short = shortened(path, free)
    assert short[0].tobytes() == path[0].tobytes() and short[-1].tobytes() == path[-1].tobytes()
    assert all(free(a, b) for a, b in zip(short, short[1:]))
    lengths = [np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)) for points in (path, short)]
    # the shortest way round the disc: two tangents and an arc
    shortest = 2.0 * np.sqrt(3.0) + np.pi / 3.0
    assert shortest <= lengths[1] < 1.08 * shortest < lengths[0]
    assert shortened(short, free).shape[0] <= short.shape[0]
    np.testing.assert_array_equal(shortened(path[:2], free), path[:2])
    straight = shortened(np.array([[-2.0, 2.0], [0.0, 3.0], [2.0, 2.0]]), free)
    np.testing.assert_array_equal(straight, [[-2.0, 2.0], [2.0, 2.0]])


def test_the_search_stays_within_its_bounds():
    edges = MotionValidator(world(WALL), LEVERS, 0.1)
    room = np.minimum(RIGHT, LEFT) - 1.0, np.maximum(RIGHT, LEFT) + 1.0
    bounds = np.maximum(room[0], BOUNDS[0]), np.minimum(room[1], BOUNDS[1])
    path = OmplSearch("RRTConnect", time.monotonic).find(PathQuery(RIGHT, [LEFT], edges, *bounds, seed=3), 10.0)
    assert np.all((path >= bounds[0] - 1e-12) & (path <= bounds[1] + 1e-12))


def test_a_goal_behind_contact_all_around_is_not_found():
    edges = MotionValidator(Recorder(most=0.3), LEVERS, 0.1)
    query = PathQuery(HOME, [HOME + np.eye(6)[0]], edges, *BOUNDS, seed=1)
    with pytest.raises(NoPathError, check=lambda error: error.planner == "RRTConnect"):
        OmplSearch("RRTConnect", time.monotonic).find(query, 0.05)


@pytest.mark.parametrize(
    "files",
    [("urdf/kr120_track.urdf.xacro", "config/kr120_track.yaml"), ("test/data/ur_like.urdf", "test/data/ur_like.yaml")],
)
def test_other_arms_are_planned_for_by_the_same_code(files):
    robot = read_robot_files(*(ROOT / name for name in files))
    chain = Chain(robot)
    inverse = inverse_kinematics(chain, IkSettings(budget_s=5.0), np.random.default_rng(0), time.monotonic)
    home = np.array(robot.home)
    goal = np.clip(home + 0.6, robot.lower, robot.upper)
    tool = 0.5 * (chain.forward(home).position + chain.forward(goal).position)
    settings = PlannerSettings(**QUICK)
    planner = Planner(robot, inverse, settings, time.monotonic)
    found = sample_self_collision(robot, samples=1000)
    empty = CollisionWorld(robot, Scene(), found)
    posted = empty.with_scene(Scene((SceneObject("post", "sphere", (0.02,), tuple(tool)),), 0.005))
    for surroundings in (empty, posted):
        plan = planner.plan_to_pose(home, chain.forward(goal), REQUEST, surroundings)
        reached = chain.forward(plan.trajectory.positions[-1])
        np.testing.assert_allclose(reached.position, chain.forward(goal).position, atol=1e-5)
        assert plan.trajectory.joint_names == robot.joint_names
        times = np.arange(0.0, plan.trajectory.duration, 0.004)
        assert surroundings.all_free(plan.trajectory.sample_many(times)[0]) is None


def test_a_path_that_touches_something_becomes_no_plan(monkeypatch):
    monkeypatch.setattr(OmplSearch, "find", lambda _, query, budget: np.array([query.start, query.goals[0]]))
    with pytest.raises(NoPathError, check=lambda error: error.planner == "RRTConnect"):
        planner(planning_budget=0.1).plan_to_joints(RIGHT, LEFT, REQUEST, world(WALL))
