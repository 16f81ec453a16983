"""scene.self_collision: which links are not checked against each other, why, and that the file says the same every time."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
import yaml
from scene_samples import ROOT, kr120, kr120_pairs, random_poses, track7, ur_like, ur_like_pairs

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.ros.commands.new_arm import sample_pairs
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import (
    NEAR,
    SelfCollision,
    geometry_hash,
    read_self_collision,
    sample_self_collision,
)

SHIPPED = ROOT / "config" / "kr120_self_collision.yaml"
XACRO, ROBOT_YAML = ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml"
#: KUKA's own home, and each axis at the ends of its range from ours [deg]; the forearm's with the upper arm up or back
KUKA_HOME = (0, -90, 90, 0, 0, 0)
HOME = (0, -90, 90, 0, 90, 0)
ENDS = [(-185, 185), (-140, -5), (-120, 155), (-350, 350), (-125, 125), (-350, 350)]
COMBINED = [(0, -140, -120, 0, 0, 0), (0, -140, 155, 0, 0, 0), (0, -5, -120, 0, 0, 0), (0, -5, -120, 0, 90, 0)]


@pytest.mark.parametrize("xacro, robot", [("kr120r2500", "kr120"), ("kr120_track", "kr120_track")])
def test_the_shipped_file_is_what_the_command_writes(xacro, robot, tmp_path, capsys):
    written = tmp_path / "pairs.yaml"
    sample_pairs([str(ROOT / f"urdf/{xacro}.urdf.xacro"), str(ROOT / f"config/{robot}.yaml"), str(written)])
    assert written.read_bytes() == (ROOT / f"config/{robot}_self_collision.yaml").read_bytes()
    assert f"geometry {read_self_collision_hash(written)[:12]} of {robot}" in capsys.readouterr().out


def read_self_collision_hash(path) -> str:
    return yaml.safe_load(path.read_text())["geometry"]


def test_other_samples_give_another_file_and_the_same_one_twice(capsys):
    texts = []
    for seed in ("1", "1", "2"):
        sample_pairs([str(XACRO), str(ROBOT_YAML), "-", "--samples", "300", "--seed", seed])
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1] != texts[2]
    assert yaml.safe_load(texts[0])["samples"] == 300


def test_neighbours_and_the_wrist_are_adjacent():
    reasons = {tuple(sorted(pair)): reason for pair, reason in kr120_pairs().ignored.items()}
    adjacent = {pair for pair, reason in reasons.items() if reason == "adjacent"}
    assert adjacent == {(f"link_{n}", f"link_{n + 1}") for n in range(6)} | {("link_3", "link_5"), ("link_4", "link_6")}
    assert {reason for reason in reasons.values()} <= {"adjacent", "always", "never"}
    assert kr120_pairs().ignores("link_1", "link_0") and not kr120_pairs().ignores("link_1", "link_6")


def test_pairs_that_are_never_in_contact_are_free_in_other_samples_too():
    every = SelfCollision({pair: why for pair, why in kr120_pairs().ignored.items() if why == "adjacent"}, "")
    few, all_but_adjacent = (CollisionWorld(kr120(), Scene(), pairs) for pairs in (kr120_pairs(), every))
    for q in random_poses(kr120(), 5000, seed=99):
        assert few.is_free(q) == all_but_adjacent.is_free(q)


def test_pairs_that_always_touch_are_found():
    # two balls on neighbours of neighbours, larger than the gap between them
    urdf = kr120().urdf.replace('<box size="0.24 0.16 0.17"/>', '<sphere radius="2.5"/>')
    found = sample_self_collision(replace(kr120(), urdf=urdf), samples=50)
    assert found.ignored[frozenset(("link_2", "link_5"))] == "always"


def test_an_arm_without_a_spherical_wrist_has_its_own_pairs():
    assert ur_like_pairs().ignored
    assert CollisionWorld(ur_like(), Scene(), ur_like_pairs()).is_free(ur_like().home)
    assert sample_self_collision(ur_like(), samples=500).ignored == ur_like_pairs().ignored


def test_reading_gives_what_was_written(tmp_path):
    path = tmp_path / "pairs.yaml"
    sample_pairs(
        [str(ROOT / "test/data/ur_like.urdf"), str(ROOT / "test/data/ur_like.yaml"), str(path), "--samples", "500"]
    )
    assert read_self_collision(path, ur_like()) == ur_like_pairs()


def test_the_hash_follows_shapes_joints_and_ranges_only():
    original = geometry_hash(RobotBodies(kr120()))
    assert original == kr120_pairs().geometry_hash
    changed = [
        replace(kr120(), urdf=kr120().urdf.replace('radius="0.37"', 'radius="0.38"')),
        replace(kr120(), urdf=kr120().urdf.replace('xyz="1.150 0 0"', 'xyz="1.160 0 0"')),
        replace(kr120(), upper=(*kr120().upper[:-1], 3.0)),
    ]
    assert len({original, *(geometry_hash(RobotBodies(robot)) for robot in changed)}) == 4
    ghost = replace(kr120(), urdf=kr120().urdf.replace("1.0 0.36 0.05", "0.0 0.36 0.05"))
    assert geometry_hash(RobotBodies(ghost)) == original


@pytest.mark.parametrize("name", ["kr120", "my_arm"])
def test_a_file_of_another_geometry_is_refused_with_a_command_that_writes_over_nobody_s_file(name):
    """A robot that was given no file has that of the KR 120, by name even its own: what is printed must leave it as it is."""
    longer = replace(kr120(), name=name, urdf=kr120().urdf.replace('radius="0.37"', 'radius="0.38"'))
    with pytest.raises(ConfigurationError) as caught:
        read_self_collision(SHIPPED, longer)
    assert caught.value.value == kr120_pairs().geometry_hash
    assert str(caught.value).startswith(str(SHIPPED)) and str(caught.value).count(str(SHIPPED)) == 1
    assert "`rosrun construction_twin new_arm self_collision <urdf or xacro> <robot.yaml> <new file>`" in str(
        caught.value
    )


@pytest.mark.parametrize(
    "change, named",
    [
        ({"seed": None}, "seed"),
        ({"samples": 0}, "samples"),
        ({"geometry": "abc"}, "geometry"),
        ({"ignored": [["link_0", "link_1", "tired"]]}, "ignored/0/2"),
        ({"ignored": [["link_0", "link_1"]]}, "ignored/0"),
        ({"more": 1}, "more"),
    ],
)
def test_a_bad_file_is_refused(change, named, tmp_path):
    description = yaml.safe_load(SHIPPED.read_text()) | change
    path = tmp_path / "pairs.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in description.items() if value is not None}))
    with pytest.raises(ConfigurationError) as caught:
        read_self_collision(path, kr120())
    assert named in caught.value.where


@pytest.mark.parametrize("text", ["[]", ": {", ""])
def test_a_file_that_is_no_mapping_is_refused(text, tmp_path):
    path = tmp_path / "pairs.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError):
        read_self_collision(path, kr120())
    with pytest.raises(ConfigurationError):
        read_self_collision(tmp_path / "none.yaml", kr120())


def poses_in_reach() -> list[tuple]:
    """Return the homes, and every axis at both ends of its range [deg]."""
    poses = [KUKA_HOME, HOME, *COMBINED]
    for axis, ends in enumerate(ENDS):
        poses += [(*HOME[:axis], end, *HOME[axis + 1 :]) for end in ends]
    return poses


@pytest.mark.parametrize("pose", poses_in_reach(), ids=str)
def test_the_arm_does_not_touch_itself_where_it_may_go(pose):
    checked = CollisionWorld(kr120(), Scene(), kr120_pairs())
    assert checked.contact(np.radians(pose)) is None


def test_the_robot_yaml_and_urdf_are_the_ones_the_tests_use():
    assert read_robot_files(XACRO, ROBOT_YAML) == kr120()


def measured(robot: RobotModel, pairs: list, samples: int, seed: int) -> dict[tuple[str, str], list[float]]:
    """Return the distance of every pair of links in every pose, each measured by itself."""
    bodies = RobotBodies(robot)
    geometry = pinocchio.GeometryModel()
    for index, body in enumerate(bodies.bodies):
        geometry.addGeometryObject(pinocchio.GeometryObject(str(index), body.joint, body.placement, body.geometry))
    wanted, owners = set(pairs), []
    for second, first in ((second, first) for second in range(len(bodies.bodies)) for first in range(second)):
        owner = bodies.bodies[first].link, bodies.bodies[second].link
        if owner in wanted:
            geometry.addCollisionPair(pinocchio.CollisionPair(first, second))
            owners.append(owner)
    data, shapes = bodies.model.createData(), geometry.createData()
    distances: dict[tuple[str, str], list[float]] = {pair: [] for pair in wanted}
    for pose in [robot.home, *random_poses(robot, samples - 1, seed)]:
        q = pinocchio.neutral(bodies.model)
        q[bodies.order] = pose
        pinocchio.computeDistances(bodies.model, data, geometry, shapes, q)
        closest = dict.fromkeys(wanted, float("inf"))
        for owner, result in zip(owners, shapes.distanceResults):
            closest[owner] = min(closest[owner], result.min_distance)
        for owner, distance in closest.items():
            distances[owner].append(distance)
    return distances


@pytest.mark.parametrize("robot", [kr120(), ur_like(), track7()], ids=lambda robot: robot.name)
def test_leaving_out_what_is_decided_changes_no_answer(robot):
    found = sample_self_collision(robot, 600, 3).ignored
    joints = {body.link: body.joint for body in RobotBodies(robot).bodies}
    pairs = [
        pair
        for pair in itertools.combinations(joints, 2)
        if joints[pair[0]] != joints[pair[1]] and found.get(frozenset(pair)) != "adjacent"
    ]
    for pair, values in measured(robot, pairs, 600, 3).items():
        expected = "always" if max(values) <= 0 else "never" if min(values) > NEAR else None
        assert found.get(frozenset(pair)) == expected
