"""The world of the twin in Gazebo: libsdformat accepts it, and it has the planner's links, masses and objects."""

from __future__ import annotations

import ctypes
import ctypes.util
import dataclasses
import struct
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest
from physics_samples import OTHERS, ROOT, bodies_of, drives, pairs_of

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.physics.drive import drives_of
from construction_twin.extensions.physics.model import build_model
from construction_twin.extensions.physics.nodes.gazebo import PLUGIN, GazeboWorld, world_of
from construction_twin.robot.description import load_robot
from construction_twin.robot.new_robot import new_description
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_yaml import read_scene

ARMS = ("kr120", "kr120_track", *OTHERS)
BOX = SceneObject("box", "box", (0.2, 0.3, 0.4), (1.0, -1.0, 0.5))


def sdformat() -> ctypes.CDLL:
    """Return Debian's library; what its command line calls has a C interface."""
    name = ctypes.util.find_library("sdformat12")
    if name is None:
        pytest.skip("this system has no libsdformat12: Debian 13 has none")
    library = ctypes.CDLL(name)
    library.cmdCheck.argtypes = [ctypes.c_char_p]
    return library


def accepted(text: str, folder: Path) -> bool:
    file = folder / "checked.world"
    file.write_text(text)
    return sdformat().cmdCheck(str(file).encode()) == 0


def parsed(world: GazeboWorld) -> ElementTree.Element:
    return ElementTree.fromstring(world.sdf).find("world")


def in_scene(*objects: SceneObject, name: str = "kr120", folder: Path = Path("/none")) -> GazeboWorld:
    return world_of(bodies_of(name), Scene(objects), drives(name), folder)


def written(world: GazeboWorld, folder: Path) -> str:
    for name, contents in world.meshes.items():
        (folder / name).write_bytes(contents)
    return world.sdf


@pytest.mark.parametrize("name", ARMS)
def test_sdformat_accepts_every_arm_in_the_shipped_scene(name, tmp_path):
    world = world_of(bodies_of(name), read_scene(ROOT / "config/scene.yaml"), drives(name), tmp_path)
    assert accepted(written(world, tmp_path), tmp_path)


@pytest.mark.parametrize("name", ARMS)
def test_links_stand_where_pinocchio_has_them_and_the_arm_weighs_what_mujoco_s_does(name):
    bodies = bodies_of(name)
    world = parsed(in_scene(name=name))
    links = world.findall(".//model/link/inertial/..")
    model = bodies.model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, pinocchio.neutral(model))
    assert len(links) == model.njoints - 1
    for index, link in enumerate(links, start=1):
        x, y, z, *rpy = map(float, link.findtext("pose").split())
        np.testing.assert_allclose((x, y, z), data.oMi[index].translation, atol=1e-12)
        np.testing.assert_allclose(pinocchio.rpy.rpyToMatrix(*rpy), data.oMi[index].rotation, atol=1e-9)
    masses = [float(link.findtext("inertial/mass")) for link in links]
    mujoco = build_model(bodies, Scene(), pairs_of(name), drives(name))
    moving = [float(mujoco.model.body(f"joint\n{joint}").mass[0]) for joint in model.names[1:]]
    np.testing.assert_allclose(masses, moving, rtol=1e-12)


def test_its_numbers_are_those_of_the_simulation():
    world = parsed(in_scene())
    mujoco = build_model(bodies_of("kr120"), Scene(), pairs_of("kr120"), drives()).model
    assert float(world.findtext("physics/max_step_size")) == mujoco.opt.timestep
    np.testing.assert_array_equal([float(one) for one in world.findtext("gravity").split()], mujoco.opt.gravity)
    # as fast as it is commanded, and all equations of the chain at once
    assert world.findtext("physics/real_time_update_rate") == "0"
    assert world.findtext("physics/ode/solver/type") == "world"
    assert world.find(".//plugin").get("filename") == PLUGIN
    assert world_of(bodies_of("kr120"), Scene(), drives(), Path("/none"), 40).sdf.count("<realtime>40<") == 1


def test_a_linear_joint_slides_and_no_joint_has_a_stop():
    joints = parsed(in_scene(name="kr120_track")).findall(".//joint")
    assert [joint.get("type") for joint in joints] == ["prismatic", *["revolute"] * 6]
    for joint in joints:
        assert float(joint.findtext("axis/limit/upper")) > 1e10 and float(joint.findtext("axis/limit/lower")) < -1e10
    # of each the one before is the parent
    assert [joint.findtext("parent") for joint in joints][1:] == [joint.findtext("child") for joint in joints][:-1]


def collides(world: GazeboWorld, name: str) -> bool:
    return any(str(one.get("name")).startswith(name) for one in parsed(world).iter("collision"))


def test_pairs_that_the_planner_does_not_check_never_meet():
    """Gazebo cannot leave out a pair: what may touch something touches nothing."""
    table = SceneObject("table", "box", (1.0, 1.0, 0.5), (1.5, 0.0, 0.25))
    apart = in_scene(table, BOX)
    assert collides(apart, "table") and collides(apart, "box")
    lifted = in_scene(table, dataclasses.replace(BOX, touch=("table",)))
    assert not collides(lifted, "table") and not collides(lifted, "box")
    # neighbours of the arm touch, and the pedestal stands on the floor
    assert not collides(apart, "link_0") and collides(apart, "link_1")
    assert parsed(apart).find(".//self_collide") is None


def test_what_the_arm_carries_weighs_on_its_link_and_is_an_estimate():
    carried = dataclasses.replace(BOX, position=(0.0, 0.0, 0.3), link="tool0")
    free, loaded = in_scene(), in_scene(carried)

    def mass(world: GazeboWorld) -> float:
        return float(parsed(world).findall(".//inertial/mass")[-1].text)

    assert mass(loaded) - mass(free) == pytest.approx(0.2 * 0.3 * 0.4 * 1000.0)
    assert any("box" in str(remark) and "24.0 kg" in str(remark) for remark in loaded.remarks)
    # and the plugin calculates with it
    chains = [parsed(world).findtext(".//plugin/chain").split("\n")[-2].split() for world in (free, loaded)]
    assert float(chains[1][17]) - float(chains[0][17]) == pytest.approx(24.0)


def mesh(path: Path, vertices: np.ndarray, triangles: list) -> SceneObject:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n")
    return SceneObject("wedge", "mesh", (1.0, 1.0, 1.0), (1.0, 1.0, 0.0), mesh=str(path))


@pytest.mark.parametrize("closed", [True, False])
def test_a_mesh_is_a_file_beside_the_world(tmp_path, closed):
    corners = np.array(((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)), dtype=float)
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    item = mesh(tmp_path / "wedge.obj", corners, faces if closed else faces[:3])
    world = in_scene(item, folder=tmp_path)
    assert accepted(written(world, tmp_path), tmp_path)
    ((name, contents),) = world.meshes.items()
    assert parsed(world).findtext(".//collision/geometry/mesh/uri") == f"file://{tmp_path / name}"
    (count,) = struct.unpack_from("<I", contents, 80)
    assert count == (4 if closed else 3) and len(contents) == 84 + 50 * count
    triangles = np.frombuffer(contents[84:], dtype=[("numbers", "<f4", 12), ("attribute", "<u2")])["numbers"]
    points = triangles.reshape(-1, 4, 3)
    np.testing.assert_array_equal(np.unique(points[:, 1:].reshape(-1, 3), axis=0), np.unique(corners, axis=0))
    # normals as the corners turn, and outwards
    turned = np.cross(points[:, 2] - points[:, 1], points[:, 3] - points[:, 1])
    assert (np.einsum("ij,ij->i", turned, points[:, 0]) > 0.0).all()
    if closed:
        assert (np.einsum("ij,ij->i", points[:, 1] - corners.mean(axis=0), points[:, 0]) > 0.0).all()


def test_an_arm_with_a_joint_that_follows_another_is_refused():
    urdf = (ROOT / "test/data/balanced_like.urdf").read_text()
    robot = load_robot(urdf, new_description(urdf, "balanced", "base_link", "tool0", 1.0))
    with pytest.raises(ConfigurationError, match="no joint follows another"):
        world_of(RobotBodies(robot), Scene(), drives_of(robot), Path("/none"))


def test_joints_outside_of_the_chain_stand_where_the_planner_has_them():
    world = in_scene(name="ur_like_gripper")
    joints = [joint.get("name") for joint in parsed(world).findall(".//joint")]
    assert joints == list(bodies_of("ur_like_gripper").robot.joint_names)
