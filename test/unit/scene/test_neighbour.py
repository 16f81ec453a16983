"""Another arm as an obstacle: its copies enclose it, along a path too; a way is free beside it and not through it."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from neighbour_cell import AWAY, BESIDE, CLEAR, NEAR, STRETCHED, TOWARDS, empty_world, line, other
from planning_cell import HOME, QUICK, REQUEST, ROBOT, SELF_COLLISION, Clock, solver

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.recheck import CollisionError
from construction_twin.ros.nodes.neighbour import NeighbourUnknownError
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.neighbour import ROUNDING, STEP, Neighbour, key_rows, load_cell
from construction_twin.scene.objects import Scene, SceneObject


def distance_to(obstacle, point: np.ndarray) -> float:
    """Return how far a point is outside of an obstacle's padded shape [m]."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    at = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
    to = coal.Transform3s(np.eye(3), point)
    found = coal.distance(obstacle.geometry, at, coal.Sphere(1e-6), to, request, result)
    return found - obstacle.padding


def body_points(place: Pose, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return points on the other arm's shapes in our root, by owner: made without the code that is tested."""
    bodies = RobotBodies(ROBOT)
    data = bodies.model.createData()
    pinocchio.forwardKinematics(bodies.model, data, np.asarray(q)[np.argsort(bodies.order)])
    root = pinocchio.SE3(place.rotation, place.position)
    points: dict[str, list] = {}
    for body in bodies.bodies:
        body.geometry.computeLocalAABB()
        pose = root * data.oMi[body.joint] * body.placement
        points.setdefault(f"other/{body.owner}", []).append(pose.act(np.array(body.geometry.aabb_center)))
    return {owner: np.array(found) for owner, found in points.items()}


SHARES = st.tuples(*[st.floats(0.02, 0.98)] * 6)


def pose(fractions) -> np.ndarray:
    return np.array(ROBOT.lower) + np.array(fractions) * (np.array(ROBOT.upper) - np.array(ROBOT.lower))


@settings(max_examples=12, deadline=None)
@given(SHARES, SHARES, st.floats(0.0, 1.0))
def test_the_swept_union_encloses_every_pose_between(start, end, fraction):
    path = line(pose(start), pose(end), 600)
    swept = other().space_along(path)
    between = path[0] + fraction * (path[-1] - path[0])
    for owner, points in body_points(BESIDE, between).items():
        copies = [copy for copy in swept if copy.owner == owner]
        for point in points:
            assert min(distance_to(copy, point) for copy in copies) <= 1e-5, owner


def test_what_does_not_move_is_kept_once_and_unpadded():
    swept = other().space_along(line(AWAY, TOWARDS))
    pedestal = [copy for copy in swept if copy.owner == "other/link_0"]
    assert pedestal and len({id(copy.geometry) for copy in pedestal}) == len(pedestal)
    assert {copy.padding for copy in pedestal} == {ROUNDING}


def test_padding_is_half_the_way_between_two_copies():
    swept = other().space_along(line(AWAY, TOWARDS))
    paddings = [copy.padding for copy in swept]
    assert STEP / 4 < max(paddings) <= STEP / 2 + 0.02 + ROUNDING


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.0, 0.05), min_size=1, max_size=200), st.floats(0.01, 1.0))
def test_key_rows_are_a_step_apart_and_hold_both_ends(steps, step):
    travel = np.concatenate(([0.0], np.cumsum(steps)))
    keys = key_rows(travel, step)
    assert keys == sorted(set(keys)) and keys[0] == 0
    if travel[-1] <= ROUNDING:
        assert keys == [0]
    else:
        assert keys[-1] == len(travel) - 1
        assert np.diff(travel[keys]).max() <= step + max(steps) + 1e-9


def test_a_way_that_is_free_beside_one_pose_is_blocked_by_another():
    world = empty_world()
    way = line(NEAR, HOME)
    assert world.with_neighbour(other().space_between(AWAY, AWAY)).all_free(way) is None
    blocked = world.with_neighbour(other().space_between(TOWARDS, TOWARDS))
    row = blocked.all_free(way)
    assert row is not None
    assert blocked.contact(way[row]).between[1].startswith("other/")


def test_a_path_through_a_way_blocks_it_although_both_its_ends_do_not():
    world, start, end = empty_world(), AWAY, TOWARDS + np.radians([90, 0, 0, 0, 0, 0])
    ends = (*other().space_between(start, start), *other().space_between(end, end))
    assert world.with_neighbour(ends).is_free(NEAR)
    assert not world.with_neighbour(other().space_along(line(start, end))).is_free(NEAR)


def test_the_boxes_that_come_first_hide_no_contact():
    """Whole-arm boxes and left-out pairs against every pair measured one by one."""
    obstacles = other().space_along(line(AWAY, TOWARDS))
    alone, world = empty_world(), empty_world().with_neighbour(obstacles)
    rng = np.random.default_rng(3)
    poses = NEAR + rng.uniform(-0.9, 0.9, (150, 6))
    poses = [q for q in poses if alone.is_free(q)]
    found = [world.is_free(q) for q in poses]
    assert 10 < sum(found) < len(found) - 10
    for q, free in zip(poses, found):
        assert free == _measured_free(q, obstacles)


def _measured_free(q, obstacles) -> bool:
    bodies = RobotBodies(ROBOT)
    data = bodies.model.createData()
    pinocchio.forwardKinematics(bodies.model, data, q)
    for body in bodies.bodies:
        if body.joint:
            at = data.oMi[body.joint] * body.placement
            here = coal.Transform3s(at.rotation, at.translation)
            for item in obstacles:
                there = coal.Transform3s(item.placement.rotation, item.placement.translation)
                request = coal.CollisionRequest()
                request.security_margin = item.padding
                if coal.collide(body.geometry, here, item.geometry, there, request, coal.CollisionResult()):
                    return False
    return True


def test_an_arm_out_of_reach_costs_nothing():
    far_away = Pose(np.array([0.0, 12.0, 0.0]), np.eye(3))
    obstacles = Neighbour("other", ROBOT, far_away).space_along(line(AWAY, TOWARDS))
    alone, beside = (one.distances(NEAR) for one in (empty_world(), empty_world().with_neighbour(obstacles)))
    assert [pair.between for pair in beside] == [pair.between for pair in alone]


def test_what_the_other_arm_carries_is_an_obstacle_and_what_stands_in_its_scene_is_not():
    beam = SceneObject("beam", "box", (0.1, 0.1, 2.0), (0.0, 0.0, 1.0), link="tool0", touch=("link_6",))
    table = SceneObject("table", "box", (1.0, 1.0, 1.0), (1.5, 0.0, 0.5))
    owners = {item.owner for item in other().carrying((beam, table)).space_between(AWAY, AWAY)}
    assert "other/beam" in owners and "other/table" not in owners


def test_our_own_load_is_checked_against_the_other_arm():
    load = SceneObject("load", "box", (0.2, 0.2, 3.0), (0.0, 0.0, 1.5), link="tool0", touch=("link_6",))
    obstacles = other().space_between(AWAY, AWAY)
    q = HOME + np.radians([-90, 0, 0, 0, -90, 0])
    assert empty_world().with_neighbour(obstacles).is_free(q)
    loaded = empty_world(load).with_neighbour(obstacles)
    assert not loaded.is_free(q)
    assert loaded.contact(q).between[0] == "load"


def test_what_stands_in_our_scene_is_not_checked_against_the_other_arm():
    wall = SceneObject("wall", "box", (1.0, 1.0, 1.0), tuple(BESIDE.position))
    assert empty_world(wall).with_neighbour(other().space_between(AWAY, AWAY)).is_free(CLEAR)


def test_small_noise_gives_the_same_obstacles_and_motion_others():
    neighbour = Neighbour("other", ROBOT, BESIDE)
    first = neighbour.space_between(AWAY, AWAY)
    assert neighbour.space_between(AWAY + 1e-5, AWAY) is first
    assert neighbour.space_between(AWAY + 1e-2, AWAY) is not first


def test_an_arm_that_trails_its_command_may_be_anywhere_on_the_way():
    apart = other().space_between(AWAY, AWAY + np.radians([30, 0, 0, 0, 0, 0]))
    for owner, points in body_points(BESIDE, AWAY + np.radians([13, 0, 0, 0, 0, 0])).items():
        for point in points:
            assert min(distance_to(copy, point) for copy in apart if copy.owner == owner) <= 1e-5


def pipeline(neighbour) -> PlanningPipeline:
    settings_ = PlannerSettings(**QUICK)
    made = PlanningPipeline(ROBOT, solver(), settings_, SELF_COLLISION, Clock(), neighbour=neighbour)
    made.set_scene(Scene((), 0.0))
    return made


def test_the_planner_goes_around_where_the_other_arm_is():
    start, goal = HOME + np.radians([-20, 45, -45, 0, 0, 0]), HOME + np.radians([-100, 45, -45, 0, 0, 0])
    free = pipeline(None).to_joints(start, goal, REQUEST)
    assert free.planner == "direct"
    obstacles = [item.padded(0.1) for item in other().space_between(STRETCHED, STRETCHED)]
    around = pipeline(lambda: obstacles).to_joints(start, goal, REQUEST)
    assert around.planner == "RRTConnect"
    assert around.scene == free.scene
    samples = around.trajectory.sample_many(np.arange(0.0, around.trajectory.duration, 0.004))[0]
    assert empty_world().with_neighbour(obstacles).all_free(samples) is None
    assert empty_world().with_neighbour(obstacles).all_free(line(start, goal)) is not None


def test_a_goal_inside_the_other_arm_is_refused_by_name():
    obstacles = other().space_between(TOWARDS, TOWARDS)
    with pytest.raises(CollisionError, match="other/"):
        pipeline(lambda: obstacles).to_joints(CLEAR, NEAR, REQUEST)


def test_a_silent_neighbour_is_never_taken_to_be_absent():
    def unknown():
        raise NeighbourUnknownError("kr120_2", "no message on /kr120_2/twin/joint_states")

    with pytest.raises(NeighbourUnknownError, match="where kr120_2 is, or goes, is not known"):
        pipeline(unknown).to_joints(HOME, NEAR, REQUEST)


def test_the_cell_says_where_the_other_arm_stands():
    places = {
        "a": {"xyz": [1.0, 0.0, 0.0], "rpy_deg": [0, 0, 90]},
        "b": {"xyz": [1.0, 2.0, 0.5], "rpy_deg": [0, 0, 90]},
    }
    found = load_cell(places).root_T_root("a", "b")
    np.testing.assert_allclose(found.position, [2.0, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    "description, where",
    [
        (None, "cell"),
        ({"a": {"xyz": [0, 0], "rpy_deg": [0, 0, 0]}}, "cell/a/xyz/2"),
        ({"a": {"xyz": [0, 0, float("nan")], "rpy_deg": [0, 0, 0]}}, "cell/a/xyz/2"),
        ({"a": {"xyz": [0, 0, 0]}}, "cell/a/rpy_deg"),
        ({"a": {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0], "rpy": 1}}, "cell/a/rpy"),
    ],
)
def test_a_cell_that_makes_no_sense_is_refused(description, where):
    with pytest.raises(ConfigurationError) as caught:
        load_cell(description)
    assert caught.value.where == where


def test_a_robot_that_is_not_in_the_cell_is_refused():
    with pytest.raises(ConfigurationError, match="one named 'b'"):
        load_cell({"a": {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0]}}).root_T_root("a", "b")
