"""Forward kinematics and Jacobian: the KR 120 against docs/rsi.md, an arm built quite differently, a linear track."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotations import rotation_angle

from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.frames import abc_to_rotation, rotation_to_abc

ROOT = Path(__file__).parents[3]
KR120 = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
UR_LIKE = read_robot_files(ROOT / "test/data/ur_like.urdf", ROOT / "test/data/ur_like.yaml")
TRACK = read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml")
CHAINS = {robot.name: Chain(robot) for robot in (KR120, UR_LIKE, TRACK)}
#: Facts sheet, section 10: A1..A6 [deg], X Y Z [mm], A B C [deg]
VECTORS = [
    ((0, -90, 90, 0, 90, 0), (1350.000, 0, 1569.000), (180, 0, 180)),
    ((0, -90, 90, 0, 0, 0), (1565.000, 0, 1784.000), (0, 90, 0)),
    ((0, 0, 0, 0, 0, 0), (2715.000, 0, 634.000), (0, 90, 0)),
    ((30, -80, 100, 20, 60, -45), (1281.521, -813.421, 1225.799), (114.8444, 19.2695, -172.4208)),
    ((-90, -60, 70, 0, 80, 0), (0, 1902.688, 1241.904), (-90, 0, 180)),
]


@pytest.fixture(scope="module")
def chain() -> Chain:
    return CHAINS["kr120"]


def joints(name: str):
    """Return a strategy for joint values of a robot within its ranges."""
    robot = CHAINS[name].robot
    return st.tuples(*(st.floats(low, high) for low, high in zip(robot.lower, robot.upper)))


any_arm = st.sampled_from(sorted(CHAINS)).flatmap(lambda name: st.tuples(st.just(CHAINS[name]), joints(name)))


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


@given(any_arm)
def test_every_pose_lies_within_the_reach(case):
    arm, q = case
    assert np.linalg.norm(arm.forward(q).position - arm.shoulder) <= arm.reach + 1e-9


def test_skeleton_runs_from_the_base_to_the_tip(chain):
    points = chain.skeleton(KR120.home)
    np.testing.assert_allclose(points[0], [0, 0, 0])
    np.testing.assert_allclose(points[-1], chain.forward(KR120.home).position)
    assert np.linalg.norm(points - [0.35, 0, 1.825], axis=1).min() < 1e-9  # the elbow


@given(joints("ur_like"))
def test_forward_of_another_arm_is_the_product_of_its_joints(q):
    position, rotation = np.zeros(3), np.eye(3)
    values = iter(q)
    for joint in ElementTree.fromstring(UR_LIKE.urdf.encode()).iter("joint"):
        origin = joint.find("origin")
        if origin is not None:
            roll, pitch, yaw = (float(word) for word in origin.get("rpy").split())
            position = position + rotation @ [float(word) for word in origin.get("xyz").split()]
            rotation = rotation @ abc_to_rotation(yaw, pitch, roll)
        if joint.get("type") == "revolute":
            turn, axis = next(values), joint.find("axis").get("xyz")
            angles = {"0 0 1": (turn, 0, 0), "0 0 -1": (-turn, 0, 0), "0 1 0": (0, turn, 0)}[axis]
            rotation = rotation @ abc_to_rotation(*angles)
    pose = CHAINS["ur_like"].forward(q)
    np.testing.assert_allclose(pose.position, position, atol=1e-12)
    np.testing.assert_allclose(pose.rotation, rotation, atol=1e-12)


@given(joints("kr120_track"))
def test_track_carries_the_arm_along_x(q):
    on_floor = CHAINS["kr120"].forward(q[1:])
    on_track = CHAINS["kr120_track"].forward(q)
    np.testing.assert_allclose(on_track.position, on_floor.position + [q[0], 0.0, 0.356], atol=1e-12)
    np.testing.assert_allclose(on_track.rotation, on_floor.rotation, atol=1e-12)


@given(any_arm)
@settings(max_examples=50)
def test_jacobian_is_the_derivative_of_the_pose(case):
    arm, q = case
    jacobian = arm.jacobian(q)
    step = 1e-6
    for joint in range(len(q)):
        before, after = (
            arm.forward([value + side * step * (index == joint) for index, value in enumerate(q)])
            for side in (-0.5, 0.5)
        )
        np.testing.assert_allclose((after.position - before.position) / step, jacobian[:3, joint], atol=1e-7)
        skew = (after.rotation - before.rotation) @ arm.forward(q).rotation.T / step
        np.testing.assert_allclose([skew[2, 1], skew[0, 2], skew[1, 0]], jacobian[3:, joint], atol=1e-7)
