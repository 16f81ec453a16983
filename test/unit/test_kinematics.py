"""Kinematics of the KR 120 against the facts sheet, and of an arm built quite differently."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from construction_twin.errors import JointRangeError, KinematicsError, NoSolutionError, UnreachableError
from construction_twin.frames import abc_to_rotation, rotation_angle, rotation_to_abc
from construction_twin.kinematics.chain import Chain, IkSettings, Pose
from construction_twin.robot import load_robot, read_robot_files

ROOT = Path(__file__).parents[2]
KR120 = read_robot_files(ROOT / "urdf" / "kr120r2500.urdf.xacro", ROOT / "config" / "kr120.yaml")
#: Facts sheet, section 10: A1..A6 [deg], X Y Z [mm], A B C [deg]
VECTORS = [
    ((0, -90, 90, 0, 90, 0), (1350.000, 0, 1569.000), (180, 0, 180)),
    ((0, -90, 90, 0, 0, 0), (1565.000, 0, 1784.000), (0, 90, 0)),
    ((0, 0, 0, 0, 0, 0), (2715.000, 0, 634.000), (0, 90, 0)),
    ((30, -80, 100, 20, 60, -45), (1281.521, -813.421, 1225.799), (114.8444, 19.2695, -172.4208)),
    ((-90, -60, 70, 0, 80, 0), (0, 1902.688, 1241.904), (-90, 0, 180)),
]
#: A collaborative type of arm: other axis order, wrist not spherical, ranges of two turns, turned frames.
OTHER_URDF = """<robot name="other">
<link name="root"/><link name="l1"/><link name="l2"/><link name="l3"/>
<link name="l4"/><link name="l5"/><link name="l6"/><link name="ee"/>
{joints}
<joint name="mount" type="fixed"><parent link="l6"/><child link="ee"/>
<origin xyz="0 0.05 0" rpy="-1.2 0.3 0.5"/></joint>
</robot>"""
OTHER_JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
<limit lower="-6.28" upper="6.28" effort="1" velocity="3"/></joint>"""
OTHER_JOINTS = [
    ("pan", "root", "l1", "0 0 0.09", "0 0 0.7", "0 0 1"),
    ("lift", "l1", "l2", "0 0.14 0", "0 1.5708 0", "0 1 0"),
    ("elbow", "l2", "l3", "0 -0.12 0.43", "0 0 0", "0 1 0"),
    ("wrist_1", "l3", "l4", "0 0 0.39", "0 1.5708 0", "0 1 0"),
    ("wrist_2", "l4", "l5", "0 0.09 0", "0 0 0", "0 0 1"),
    ("wrist_3", "l5", "l6", "0 0 0.09", "0 0 0", "0 1 0"),
]


def other_robot():
    keys = ("name", "parent", "child", "xyz", "rpy", "axis")
    joints = "\n".join(OTHER_JOINT.format(**dict(zip(keys, joint))) for joint in OTHER_JOINTS)
    axes = {joint[0]: {"rsi": f"A{number}", "sign": 1, "offset_deg": 0} for number, joint in enumerate(OTHER_JOINTS, 1)}
    description = {
        "name": "other",
        "base_link": "root",
        "tip_link": "ee",
        "home_deg": [0, -60, 80, -20, 90, 0],
        "acceleration_deg_s2": [100] * 6,
        "jerk_deg_s3": [1000] * 6,
        "axes": axes,
    }
    return load_robot(OTHER_URDF.format(joints=joints), description)


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Chain(KR120)


@pytest.fixture(scope="module")
def other() -> Chain:
    return Chain(other_robot())


def solve(chain, pose, seed, number=0, budget_s=5.0):
    return chain.inverse(pose, seed, np.random.default_rng(number), budget_s, time.monotonic)


def samples(robot, count, number=1):
    return np.random.default_rng(number).uniform(robot.lower, robot.upper, size=(count, len(robot.lower)))


def assert_solves(chain, solution, pose):
    chain.robot.check_range(solution.q)
    reached = chain.forward(solution.q)
    assert np.linalg.norm(reached.position - pose.position) <= 1e-6
    assert rotation_angle(reached.rotation, pose.rotation) <= 1e-6


@pytest.mark.parametrize("q_deg, xyz_mm, abc_deg", VECTORS)
def test_forward_gives_the_facts_sheets_pose(chain, q_deg, xyz_mm, abc_deg):
    pose = chain.forward(np.radians(q_deg))
    np.testing.assert_allclose(pose.position * 1e3, xyz_mm, atol=1e-3)
    abc = np.degrees(rotation_to_abc(pose.rotation))
    difference = np.remainder(abc - abc_deg + 180.0, 360.0) - 180.0
    if abs(abc_deg[1]) == 90:  # only A - C is defined
        difference = [np.remainder(difference[0] - difference[2] + 180.0, 360.0) - 180.0, difference[1]]
    np.testing.assert_allclose(difference, 0.0, atol=1e-3)
    assert rotation_angle(pose.rotation, abc_to_rotation(*np.radians(abc_deg))) <= math.radians(1e-3)


def test_reach_is_at_least_the_published_one(chain):
    np.testing.assert_allclose(chain.shoulder, [0, 0, 0.675])
    assert chain.reach == pytest.approx(0.350 + 1.150 + math.hypot(1.0, 0.041) + 0.215)


def test_every_pose_lies_within_the_reach(chain, other):
    for arm in (chain, other):
        for q in samples(arm.robot, 50):
            assert np.linalg.norm(arm.forward(q).position - arm.shoulder) <= arm.reach


def test_skeleton_runs_from_the_base_to_the_tip(chain):
    points = chain.skeleton(KR120.home)
    np.testing.assert_allclose(points[0], [0, 0, 0])
    np.testing.assert_allclose(points[-1], chain.forward(KR120.home).position)
    assert np.linalg.norm(points - [0.35, 0, 1.825], axis=1).min() < 1e-9  # the elbow


def test_forward_of_another_number_of_joints_is_a_programming_error(chain):
    with pytest.raises(ValueError, match="5 joint values for 6 joints"):
        chain.forward([0.0] * 5)


@pytest.mark.parametrize("number", range(60))
def test_inverse_of_forward_is_the_pose_from_a_far_seed(chain, number):
    pose = chain.forward(samples(KR120, 60)[number])
    assert_solves(chain, solve(chain, pose, KR120.home, number), pose)


@pytest.mark.parametrize("number", range(30))
def test_inverse_stays_at_a_near_seed(chain, number):
    rng = np.random.default_rng(number)
    q = rng.uniform(np.array(KR120.lower) + 0.02, np.array(KR120.upper) - 0.02)
    # away from the wrist's singularity, where a small step in space is a large one in A4 and A6
    q[4] = math.copysign(max(abs(q[4]), 0.1), q[4])
    seed = q + rng.uniform(-0.002, 0.002, 6)
    np.testing.assert_allclose(solve(chain, chain.forward(q), seed, number).q, q, atol=1e-3)


@pytest.mark.parametrize("number", range(30))
def test_inverse_of_another_arm(other, number):
    pose = other.forward(samples(other.robot, 30)[number])
    assert_solves(other, solve(other, pose, other.robot.home, number), pose)


def test_forward_of_another_arm_is_the_product_of_its_joints(other):
    q = np.array([0.4, -1.1, 0.9, -0.3, 1.2, 2.0])
    axes = {"0 0 1": lambda a: abc_to_rotation(a, 0, 0), "0 1 0": lambda a: abc_to_rotation(0, a, 0)}
    position, rotation = np.zeros(3), np.eye(3)
    for (_, _, _, xyz, rpy, axis), angle in zip(OTHER_JOINTS, q):
        roll, pitch, yaw = map(float, rpy.split())
        position = position + rotation @ np.array(xyz.split(), dtype=float)
        rotation = rotation @ abc_to_rotation(yaw, pitch, roll) @ axes[axis](angle)
    position = position + rotation @ [0, 0.05, 0]
    pose = other.forward(q)
    np.testing.assert_allclose(pose.position, position, atol=1e-12)
    np.testing.assert_allclose(pose.rotation, rotation @ abc_to_rotation(0.5, 0.3, -1.2), atol=1e-12)


def test_inverse_from_a_singular_seed(chain):
    seed = np.radians([0, -90, 90, 0, 0, 0])
    pose = chain.forward(np.radians([10, -80, 95, 30, 40, -20]))
    assert_solves(chain, solve(chain, pose, seed), pose)


def test_inverse_of_a_singular_pose(chain):
    pose = chain.forward(np.radians([0, -90, 90, 0, 0, 0]))
    assert_solves(chain, solve(chain, pose, KR120.home), pose)


@pytest.mark.parametrize("ends", list(itertools.product(("lower", "upper"), repeat=2)))
def test_inverse_of_a_pose_on_the_edge_of_the_ranges(chain, ends):
    q = np.array(KR120.home)
    q[[0, 4]] = getattr(KR120, ends[0])[0], getattr(KR120, ends[1])[4]
    pose = chain.forward(q)
    assert_solves(chain, solve(chain, pose, q), pose)


@pytest.mark.parametrize(
    "turns_deg", [(0, -90, 90, 340, 60, -330), (0, -90, 90, -340, 60, 330), (170, -90, 90, 0, 60, 200)]
)
def test_inverse_stays_in_the_seeds_turn(chain, turns_deg):
    q = np.radians(turns_deg)
    np.testing.assert_allclose(solve(chain, chain.forward(q), q).q, q, atol=1e-5)


def test_inverse_turns_back_where_the_seeds_turn_is_out_of_range(chain):
    pose = chain.forward(np.radians([0, -90, 90, 0, 60, 10]))  # A6 = 370 would be nearest
    seed = np.radians([0, -90, 90, 0, 60, 345])
    solution = solve(chain, pose, seed)
    assert_solves(chain, solution, pose)


def test_same_random_numbers_same_solution(chain):
    pose = chain.forward(np.radians([30, -80, 100, 20, 60, -45]))
    first, second = (solve(chain, pose, KR120.home, 7).q for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_target_beyond_the_reach_says_by_how_much(chain):
    pose = Pose(np.array([4.0, 0.0, 0.675]), np.eye(3))
    with pytest.raises(UnreachableError) as caught:
        solve(chain, pose, KR120.home)
    assert caught.value.distance == pytest.approx(4.0)
    assert caught.value.reach == chain.reach


def test_target_inside_the_bound_but_out_of_the_wrists_reach_has_no_solution(chain):
    pose = Pose(np.array([2.7, 0.0, 0.7]), abc_to_rotation(0, -math.pi / 2, 0))
    with pytest.raises(NoSolutionError) as caught:
        solve(chain, pose, KR120.home)
    assert caught.value.seeds == IkSettings().seeds
    assert 0.01 < caught.value.residual_m + caught.value.residual_rad < math.inf


def test_pose_solved_only_out_of_range_names_the_joint():
    upper = list(KR120.upper)
    upper[0] = math.radians(10)
    lower = list(KR120.lower)
    lower[0] = math.radians(-10)
    narrow = Chain(replace(KR120, lower=tuple(lower), upper=tuple(upper)))
    pose = narrow.forward(np.radians([60, -60, 70, 0, 80, 0]))
    with pytest.raises(JointRangeError) as caught:
        solve(narrow, pose, KR120.home)
    assert caught.value.joint == "joint_a1"


def test_seed_out_of_range_is_refused(chain):
    seed = list(KR120.home)
    seed[1] = 0.0
    with pytest.raises(JointRangeError, match="joint_a2"):
        solve(chain, chain.forward(KR120.home), seed)


@pytest.mark.parametrize("position, rotation", [((math.nan, 0, 1), np.eye(3)), ((1, 0, 1), np.full((3, 3), math.inf))])
def test_pose_that_is_not_finite_is_refused(chain, position, rotation):
    with pytest.raises(KinematicsError, match="finite"):
        solve(chain, Pose(np.array(position), rotation), KR120.home)


def test_spent_budget_still_tries_the_seed(chain):
    pose = chain.forward(KR120.home)
    assert solve(chain, pose, KR120.home, budget_s=0.0).seeds == 1


def test_budget_ends_the_search(chain):
    pose = Pose(np.array([2.7, 0.0, 0.7]), abc_to_rotation(0, -math.pi / 2, 0))
    ticks = itertools.count()
    with pytest.raises(NoSolutionError) as caught:
        chain.inverse(pose, KR120.home, np.random.default_rng(0), 3.0, lambda: float(next(ticks)))
    assert caught.value.seeds == 3
