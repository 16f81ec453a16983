"""scene.pair_sampling and the command: the same answers as asking everything, on any number of processes, and what is shown."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path

import pinocchio
import pytest
from mesh_arm import write_mesh_arm
from scene_samples import ROOT, kr120, random_poses, track7, ur_like

from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.pair_sampling import OpenPairs, PairSampler, sample_pairs
from construction_twin.scene.self_collision_command import main

SAMPLES, SEED, NEAR = 600, 3, 0.05


def pairs(robot: RobotModel) -> list[tuple[str, str]]:
    links = dict.fromkeys(body.link for body in RobotBodies(robot).bodies)
    joints = {body.link: body.joint for body in RobotBodies(robot).bodies}
    return [pair for pair in itertools.combinations(links, 2) if joints[pair[0]] != joints[pair[1]]]


@cache
def measured(robot: RobotModel, samples: int) -> dict[tuple[str, str], list[float]]:
    """Return the distance of every pair of links in every pose, each measured by itself."""
    bodies = RobotBodies(robot)
    geometry = pinocchio.GeometryModel()
    for index, body in enumerate(bodies.bodies):
        geometry.addGeometryObject(pinocchio.GeometryObject(str(index), body.joint, body.placement, body.geometry))
    wanted, owners = set(pairs(robot)), []
    for second, first in ((second, first) for second in range(len(bodies.bodies)) for first in range(second)):
        owner = bodies.bodies[first].link, bodies.bodies[second].link
        if owner in wanted:
            geometry.addCollisionPair(pinocchio.CollisionPair(first, second))
            owners.append(owner)
    data, shapes = bodies.model.createData(), geometry.createData()
    distances: dict[tuple[str, str], list[float]] = {pair: [] for pair in wanted}
    for pose in [robot.home, *random_poses(robot, samples - 1, SEED)]:
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
    found = sample_pairs(robot, pairs(robot), NEAR, SAMPLES, SEED)
    distances = measured(robot, SAMPLES)
    assert found.always == {pair for pair, values in distances.items() if max(values) <= 0}
    assert found.never == {pair for pair, values in distances.items() if min(values) > NEAR}
    assert found.always and (found.never or robot is ur_like())


def test_the_number_of_processes_changes_no_answer():
    alone, others = [], []
    one = sample_pairs(kr120(), pairs(kr120()), NEAR, 1500, SEED, 1, lambda *said: alone.append(said))
    two = sample_pairs(kr120(), pairs(kr120()), NEAR, 1500, SEED, 2, lambda *said: others.append(said), worth=0.0)
    assert one == two
    # every pose was reported as done, none twice, on both ways
    for said in (alone, others):
        poses, left = zip(*said)
        assert poses[-1] == 1500 and list(poses) == sorted(poses)
        assert left[-1] == one.count and list(left) == sorted(left, reverse=True)


def test_a_pair_is_not_asked_again_when_its_answer_is_known():
    sampler = PairSampler(ur_like(), pairs(ur_like()), NEAR, SAMPLES, SEED)
    everything = OpenPairs(frozenset(pairs(ur_like())), frozenset(pairs(ur_like())))
    first = sampler.ask(0, 300, everything)
    assert first.count < everything.count
    # only what is open is answered at all
    assert sampler.ask(300, SAMPLES, OpenPairs(frozenset(), frozenset())) == OpenPairs(frozenset(), frozenset())
    assert first & sampler.ask(300, SAMPLES, everything) == sampler.ask(300, SAMPLES, first)


def write_robot_yaml(folder: Path) -> Path:
    path = folder / "mesh_arm.yaml"
    path.write_text((ROOT / "test/data/ur_like.yaml").read_text().replace("name: ur_like", "name: mesh_arm"))
    return path


def test_a_mesh_arm_with_its_proposal_of_hulls_beside_the_file(tmp_path, capsys):
    urdf, robot_yaml, output = write_mesh_arm(tmp_path), write_robot_yaml(tmp_path), tmp_path / "my_self_collision.yaml"
    main([str(urdf), str(robot_yaml), str(output), "--samples", "2000"])
    said = capsys.readouterr()
    assert said.out.startswith(f"{output}: 6 pairs left out, geometry ")
    proposal = tmp_path / "my_hulls" / "robot.urdf"
    assert f"{proposal}: a proposal, convex hulls in place of 5 meshes" in said.out
    assert all(f"\n  {link} " in said.out for link in ("shoulder", "upper_arm", "forearm", "wrist_a", "wrist_b"))
    assert said.err.splitlines()[-1] == "sampling: 2000 of 2000 poses, 0 pairs not decided"
    # it is a URDF that every command takes; what was found for the meshes does not hold for it
    assert read_robot_files(proposal, robot_yaml).joint_names == read_robot_files(urdf, robot_yaml).joint_names
    main([str(proposal), str(robot_yaml), "-", "--samples", "300"])
    assert "geometry: " + output.read_text().split("geometry: ")[1][:64] not in capsys.readouterr().out


def test_an_arm_of_simple_shapes_gets_no_proposal(tmp_path, capsys):
    output = tmp_path / "pairs.yaml"
    main([str(ROOT / "test/data/ur_like.urdf"), str(ROOT / "test/data/ur_like.yaml"), str(output), "--samples", "300"])
    assert len(capsys.readouterr().out.splitlines()) == 1 and list(tmp_path.iterdir()) == [output]
