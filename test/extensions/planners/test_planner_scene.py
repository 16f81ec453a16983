"""A scene told to another planner: shapes with their padding, MoveIt's text format read back by MoveIt's rules."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene_samples import box_triangles, clutter, kr120, kr120_pairs, track7, track7_pairs, write_stl

from construction_twin.extensions.planners.planner_scene import PlannerScene, planner_scene, scene_text
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import quaternion_to_rotation
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject

TURNED = (0.0, 0.0, math.sin(0.3), math.cos(0.3))
WALL = SceneObject("wall", "box", (0.2, 2.0, 1.5), (2.0, 0.5, 0.75), TURNED, padding=0.01, fixed=True)
PIPE = SceneObject("pipe", "cylinder", (0.1, 3.0), (-1.5, 0.0, 1.5))
BALL = SceneObject("a ball", "sphere", (0.25,), (0.0, -2.0, 1.0))
TOOL = SceneObject(
    "gripper", "box", (0.1, 0.1, 0.2), (0.0, 0.0, 0.1), padding=0.005, link="tool0", touch=("link_5", "wall")
)


def scene_for_planner(scene: Scene) -> PlannerScene:
    return planner_scene(RobotBodies(kr120()), scene, kr120_pairs())


def read(text: str) -> tuple[str, dict[str, dict]]:
    """Read a .scene file as MoveIt 1.1's loadGeometryFromStream and geometric_shapes' constructShapeFromText do."""
    name, rest = text.split("\n", 1)
    lines = iter(rest.splitlines())
    objects: dict[str, dict] = {}
    numbers = {"box": 3, "cylinder": 2, "sphere": 1}
    for line in lines:
        if line == ".":
            assert next(lines, None) is None
            return name, objects
        assert line.startswith("*")
        item = objects.setdefault(line[1:].strip(), {})
        first = next(lines)
        assert " " in first.strip(), "taken for the format without the object's pose"
        item["position"], item["quaternion"] = floats(first, 3), floats(next(lines), 4)
        assert next(lines) == "1"
        item["shape"] = next(lines)
        if item["shape"] == "mesh":
            vertices, triangles = map(int, next(lines).split())
            item["vertices"] = [floats(next(lines), 3) for _ in range(vertices)]
            item["triangles"] = [tuple(map(int, next(lines).split())) for _ in range(triangles)]
        else:
            item["size"] = floats(next(lines), numbers[item["shape"]])
        assert floats(next(lines), 3) == (0.0, 0.0, 0.0) and floats(next(lines), 4) == (0.0, 0.0, 0.0, 1.0)
        floats(next(lines), 4)
        assert next(lines) == "0"
    raise AssertionError("no end")


def floats(line: str, count: int) -> tuple[float, ...]:
    values = tuple(map(float, line.split()))
    assert len(values) == count
    return values


def test_what_stands_is_grown_by_both_paddings_and_what_is_carried_by_its_own():
    wall, pipe, ball, tool = scene_for_planner(Scene((WALL, PIPE, BALL, TOOL), padding=0.02)).objects
    assert wall.dimensions == pytest.approx((0.26, 2.06, 1.56))
    assert pipe.dimensions == pytest.approx((0.12, 3.04)) and ball.dimensions == pytest.approx((0.27,))
    assert tool.dimensions == pytest.approx((0.11, 0.11, 0.21))
    assert (tool.carried, tool.frame, wall.carried, wall.frame) == (True, "tool0", False, "base_link")


def test_moveit_reads_the_text_back_as_the_same_objects():
    text, remarks = scene_text(scene_for_planner(Scene((WALL, PIPE, BALL), padding=0.02)), "kr120 0123")
    name, objects = read(text)
    assert name == "kr120 0123" and remarks == () and list(objects) == ["wall", "pipe", "a ball"]
    assert objects["wall"]["size"] == pytest.approx((0.26, 2.06, 1.56))
    assert objects["wall"]["position"] == WALL.position
    turned = quaternion_to_rotation(objects["wall"]["quaternion"])
    np.testing.assert_allclose(turned, quaternion_to_rotation(TURNED), atol=1e-8)
    assert objects["pipe"]["size"] == pytest.approx((0.12, 3.04)) and objects["a ball"]["shape"] == "sphere"


def test_a_mesh_is_written_with_its_scale_and_without_padding(tmp_path):
    file = write_stl(tmp_path / "block.stl", box_triangles((1.0, 2.0, 3.0)))
    block = SceneObject("block", "mesh", (0.1, 0.1, 0.1), (3.0, 0.0, 0.0), mesh=file)
    text, remarks = scene_text(scene_for_planner(Scene((block,), padding=0.02)), "x")
    (item,) = read(text)[1].values()
    extent = np.ptp(np.array(item["vertices"]), axis=0)
    np.testing.assert_allclose(extent, (0.1, 0.2, 0.3), atol=1e-6)
    assert len(item["triangles"]) == 12 and max(map(max, item["triangles"])) < len(item["vertices"])
    assert remarks == ("'block' is a mesh: its padding of 20 mm is not in it",)


def test_a_carried_object_is_no_part_of_the_text_and_that_is_said():
    text, remarks = scene_text(scene_for_planner(Scene((WALL, TOOL))), "x")
    assert list(read(text)[1]) == ["wall"]
    assert remarks == ("'gripper' is carried by tool0: the format has no carried objects, attach it in the panel",)


def test_poses_are_in_the_root_of_the_urdf():
    """MoveIt plans there; the arm's base may stand elsewhere."""
    one = scene_for_planner(Scene((PIPE,)))
    raised = PlannerScene(
        one.objects, one.names, one.allowed, one.fixed_links, Pose(np.array([0.0, 0.0, 0.8]), np.eye(3)), ()
    )
    (item,) = read(scene_text(raised, "x")[0])[1].values()
    assert item["position"] == pytest.approx((-1.5, 0.0, 2.3))


def test_who_is_checked_with_whom_is_what_our_own_world_checks():
    scene = Scene((WALL, PIPE, TOOL), padding=0.02)
    seen = scene_for_planner(scene)
    index = {name: number for number, name in enumerate(seen.names)}
    assert (seen.allowed == seen.allowed.T).all() and seen.allowed.diagonal().all()

    def allowed(one: str, other: str) -> bool:
        return bool(seen.allowed[index[one], index[other]])

    assert allowed("link_0", "wall"), "pedestal and wall: nothing moves either"
    assert not allowed("link_3", "wall") and not allowed("gripper", "pipe") and not allowed("gripper", "link_0")
    assert allowed("gripper", "wall") and allowed("gripper", "link_5") and allowed("gripper", "link_6")
    assert allowed("link_1", "link_2") and not allowed("link_1", "link_5")
    assert seen.fixed_links == ("link_0",)


def test_the_track_s_base_is_its_own_frame():
    seen = planner_scene(RobotBodies(track7()), Scene((PIPE,)), track7_pairs())
    assert seen.objects[0].frame == track7().base_link and len(seen.fixed_links) >= 1


@given(st.integers(0, 50))
def test_whatever_our_world_calls_a_contact_lies_in_the_grown_shapes(seed):
    """Of clutter, as points on the surface of every object's own shape moved outward by less than its margin."""
    scene = Scene(clutter(seed, 5).objects, padding=0.03)
    random = np.random.default_rng(seed)
    for item, grown in zip(scene.objects, scene_for_planner(scene).objects):
        outward = random.normal(size=3)
        outward *= (scene.padding + item.padding) / np.linalg.norm(outward)
        if item.shape == "box":
            point = random.uniform(-0.5, 0.5, 3) * item.size + outward
            assert (np.abs(point) <= np.array(grown.dimensions) / 2 + 1e-12).all()
        elif item.shape == "cylinder":
            radius, length = item.size
            angle, part = random.uniform(0, 2 * math.pi), random.uniform(0, 1)
            point = np.array(
                [radius * part * math.cos(angle), radius * part * math.sin(angle), random.uniform(-0.5, 0.5) * length]
            )
            point += outward
            assert (
                math.hypot(*point[:2]) <= grown.dimensions[0] + 1e-12
                and abs(point[2]) <= grown.dimensions[1] / 2 + 1e-12
            )
        else:
            assert grown.dimensions[0] == pytest.approx(item.size[0] + scene.padding + item.padding)


def test_it_is_the_scene_of_a_world_that_was_checked():
    """What `CollisionWorld` refuses is refused here with the same sentence."""
    wrong = Scene((SceneObject("box", "box", (1.0, 1.0, 1.0), link="nowhere"),))
    with pytest.raises(Exception) as ours:
        CollisionWorld(kr120(), wrong, kr120_pairs())
    with pytest.raises(type(ours.value)) as theirs:
        scene_for_planner(wrong)
    assert str(ours.value) == str(theirs.value)
