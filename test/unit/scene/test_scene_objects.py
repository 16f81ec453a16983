"""scene.objects: a scene is a value, and everything wrong with one is said in one sentence."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scene_samples import FLOOR, ROOT, box_triangles, clutter, write_stl

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import abc_to_rotation
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_yaml import load_scene

BALL = SceneObject("ball", "sphere", (0.1,), (1.0, 0.0, 1.0))
SOMEWHERE = Pose(np.array([0.1, 0.2, 0.3]), abc_to_rotation(0.3, -0.2, 1.0))


def test_every_change_makes_a_new_scene_with_another_hash():
    scenes = [Scene((FLOOR,), 0.02)]
    scenes.append(scenes[-1].add(BALL))
    scenes.append(scenes[-1].attach("ball", "tool0", SOMEWHERE, ("link_6",)))
    scenes.append(scenes[-1].detach("ball", SOMEWHERE))
    scenes.append(scenes[-1].add(replace(BALL, size=(0.2,)), replace_existing=True))
    assert len({scene.hash for scene in scenes}) == len(scenes)
    assert scenes[0].names == ("floor",)
    assert scenes[4].without(["ball"]).hash == scenes[0].hash


def test_an_object_is_carried_and_put_down():
    carried = Scene((BALL,)).attach("ball", "tool0", SOMEWHERE, ("link_6", "link_5", "link_6")).get("ball")
    assert (carried.link, carried.touch, carried.position) == ("tool0", ("link_5", "link_6"), (0.1, 0.2, 0.3))
    assert np.allclose(carried.pose.rotation, SOMEWHERE.rotation, atol=1e-12)
    put_down = Scene((carried,)).detach("ball", Pose(np.zeros(3), np.eye(3))).get("ball")
    assert (put_down.link, put_down.touch, put_down.position) == ("", (), (0.0, 0.0, 0.0))


def test_the_hash_is_the_contents():
    scene = clutter()
    assert len(scene.hash) == 64
    assert Scene(scene.objects[::-1], scene.padding).hash == scene.hash
    assert Scene(scene.objects, 0.03).hash != scene.hash
    assert Scene((replace(FLOOR, fixed=False), *scene.objects[1:]), scene.padding).hash == scene.hash
    for change in (
        {"size": (20.0, 20.0, 1.1)},
        {"position": (0.0, 0.1, -0.5)},
        {"padding": 0.1},
        {"touch": ("link_1",)},
    ):
        assert Scene((replace(FLOOR, **change),)).hash != Scene((FLOOR,)).hash, change


def test_minus_zero_is_zero():
    assert Scene((replace(FLOOR, position=(-0.0, 0.0, -0.5)),), -0.0).hash == Scene((FLOOR,), 0.0).hash


def test_a_mesh_enters_the_hash_by_content_not_by_name(tmp_path):
    first = write_stl(tmp_path / "a.stl", box_triangles((1, 1, 1)))
    same = write_stl(tmp_path / "b.STL", box_triangles((1, 1, 1)))
    other = write_stl(tmp_path / "c.stl", box_triangles((1, 1, 2)))
    hashes = [Scene((SceneObject("part", "mesh", mesh=path),)).hash for path in (first, same, other)]
    assert hashes[0] == hashes[1] != hashes[2]


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda values: math.hypot(*values) > 0.1))
def test_a_normalised_quaternion_stays_as_it_is_to_the_last_bit(values):
    unit = tuple(value / math.hypot(*values) * 1.0005 for value in values)
    once = SceneObject("ball", "sphere", (0.1,), quaternion=unit)
    assert math.isclose(math.hypot(*once.quaternion), 1.0, abs_tol=1e-12)
    assert replace(once).quaternion == once.quaternion


@pytest.mark.parametrize(
    "change, named",
    [
        ({"name": " "}, "name"),
        ({"shape": "cone"}, "shape"),
        ({"size": ()}, "size"),
        ({"size": (0.1, 0.2)}, "size"),
        ({"size": (0.0,)}, "size"),
        ({"size": (math.nan,)}, "size"),
        ({"size": ("wide",)}, "size"),
        ({"position": (0.0, 0.0, math.inf)}, "position"),
        ({"position": (0.0, 0.0)}, "position"),
        ({"quaternion": (0.0, 0.0, 0.0, 0.0)}, "orientation"),
        ({"quaternion": (0.0, 0.0, 0.0, 1.1)}, "orientation"),
        ({"padding": -0.1}, "padding"),
        ({"mesh": "/tmp/part.stl"}, "mesh"),
        ({"shape": "mesh", "size": ()}, "mesh"),
        ({"shape": "mesh", "size": (), "mesh": "part.stl"}, "mesh"),
        ({"shape": "mesh", "size": (), "mesh": "/tmp/part.step"}, "mesh"),
        ({"shape": "mesh", "size": (), "mesh": "/nowhere/part.stl"}, "mesh"),
    ],
)
def test_an_object_that_makes_no_sense_is_refused(change, named):
    with pytest.raises(SceneError) as caught:
        replace(BALL, **change)
    assert named in caught.value.where
    assert "expected" in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        lambda scene: scene.add(BALL),
        lambda scene: scene.attach("wall", "tool0", SOMEWHERE),
        lambda scene: scene.attach("ball", "", SOMEWHERE),
        lambda scene: scene.detach("ball", SOMEWHERE),
        lambda scene: scene.detach("wall", SOMEWHERE),
        lambda scene: Scene((BALL, BALL)),
        lambda scene: Scene((), -1.0),
        lambda scene: Scene((), math.nan),
    ],
)
def test_a_change_that_makes_no_sense_is_refused(change):
    scene = Scene((BALL,))
    with pytest.raises(SceneError):
        change(scene)
    assert scene == Scene((BALL,))


def test_what_replaces_a_fixed_object_is_fixed():
    scene = Scene((FLOOR, BALL)).add(replace(FLOOR, fixed=False, padding=0.1), replace_existing=True)
    assert scene.get("floor").fixed and not scene.get("ball").fixed


def test_the_shipped_scene_is_a_floor_under_the_base_plate():
    path = ROOT / "config" / "scene.yaml"
    scene = load_scene(yaml.safe_load(path.read_text()), path.parent)
    floor = scene.get("floor")
    assert scene.names == ("floor",) and floor.fixed and scene.padding > 0
    assert floor.position[2] + floor.size[2] / 2 == 0.0


def test_yaml_gives_degrees_and_paths_beside_itself(tmp_path):
    write_stl(tmp_path / "part.stl", box_triangles((1, 1, 1)))
    text = """
    padding: 0.01
    objects:
      part: {shape: mesh, mesh: part.stl, rpy_deg: [0, 0, 90], position: [1, 2, 3], link: tool0, touch: [link_5]}
    """
    part = load_scene(yaml.safe_load(text), tmp_path).get("part")
    assert part.mesh == str(tmp_path / "part.stl") and part.size == (1.0, 1.0, 1.0)
    assert np.allclose(part.pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    assert (part.position, part.link, part.touch) == ((1.0, 2.0, 3.0), "tool0", ("link_5",))


@pytest.mark.parametrize(
    "description, named",
    [
        ({}, "scene/padding"),
        ({"padding": 0.0}, "scene/objects"),
        ({"padding": 0.0, "objects": {}, "floor": 1}, "scene/floor"),
        ({"padding": "wide", "objects": {}}, "scene/padding"),
        ({"padding": -1.0, "objects": {}}, "padding"),
        ({"padding": 0.0, "objects": {"ball": {"shape": "cone"}}}, "scene/objects/ball/shape"),
        ({"padding": 0.0, "objects": {"ball": {"shape": "sphere", "size": [1], "colour": "red"}}}, "ball/colour"),
        ({"padding": 0.0, "objects": {"ball": {"shape": "sphere", "size": [1, 2]}}}, "object 'ball' size"),
        ({"padding": 0.0, "objects": {"ball": {"shape": "sphere", "size": [1], "rpy_deg": [0, 0]}}}, "ball/rpy_deg"),
        ({"padding": 0.0, "objects": {"ball": {"shape": "sphere", "size": [math.inf]}}}, "ball/size"),
    ],
)
def test_a_bad_file_is_named_with_key_and_value(description, named, tmp_path):
    with pytest.raises(SceneError) as caught:
        load_scene(description, tmp_path)
    assert named in caught.value.where
