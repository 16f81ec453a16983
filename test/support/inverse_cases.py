"""Robots and checks that several tests of inverse kinematics use."""

from __future__ import annotations

import itertools
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from rotations import rotation_angle

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.kinematics.solution import BranchError
from construction_twin.robot.description import read_robot_files

ROOT = Path(__file__).parents[2]
KR120 = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
UR_LIKE = read_robot_files(ROOT / "test/data/ur_like.urdf", ROOT / "test/data/ur_like.yaml")
PANDA_LIKE = read_robot_files(ROOT / "test/data/panda_like.urdf", ROOT / "test/data/panda_like.yaml")
IIWA_LIKE = read_robot_files(ROOT / "test/data/iiwa_like.urdf", ROOT / "test/data/iiwa_like.yaml")
TRACK = read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml")


def changed(joint: str, xyz: str | None = None, rpy: str | None = None, axis: str | None = None, robot=KR120):
    """Return a robot with another origin or axis of one joint."""
    start = robot.urdf.index(f'<joint name="{joint}"')
    end = robot.urdf.index("</joint>", start)
    part = robot.urdf[start:end]
    for pattern, value in (
        (r'(<origin[^>]*xyz=")[^"]*', xyz),
        (r'(<origin[^>]*rpy=")[^"]*', rpy),
        (r'(<axis xyz=")[^"]*', axis),
    ):
        if value is not None:
            part, count = re.subn(pattern, rf"\g<1>{value}", part)
            assert count == 1
    return replace(robot, urdf=robot.urdf[:start] + part + robot.urdf[end:])


#: A KR 120 whose axis 6 passes 40 mm beside the wrist: no closed form is near.
SEARCHED = changed("joint_a5", xyz="0.05 0.04 0")


def arm_of(name: str, joints: list[tuple[str, str, str]], tip: str = "0 0 0.1", reach: float = 3.1):
    """Return an arm of revolute joints, each with origin (xyz, rpy) and axis, all with the same range to both sides."""
    parts = [f'<robot name="{name}"><link name="base"/>']
    for number, (xyz, rpy, axis) in enumerate(joints, 1):
        parent = "base" if number == 1 else f"link_{number - 1}"
        parts.append(
            f'<link name="link_{number}"/><joint name="joint_{number}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{number}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            f'<limit lower="{-reach}" upper="{reach}" velocity="2" effort="1"/></joint>'
        )
    parts.append(
        f'<link name="tip"/><joint name="flange" type="fixed"><parent link="link_{len(joints)}"/><child link="tip"/>'
        f'<origin xyz="{tip}" rpy="0.1 0.2 0.3"/></joint></robot>'
    )
    count = len(joints)
    fields = {
        field: (getattr(KR120, field) * 2)[:count] for field in ("velocity", "acceleration", "jerk", "axes", "linear")
    }
    names = tuple(f"joint_{number}" for number in range(1, count + 1))
    return replace(
        KR120, name=name, urdf="".join(parts), base_link="base", tip_link="tip", joint_names=names,
        lower=(-reach,) * count, upper=(reach,) * count, home=(0.1,) * count, **fields,
    )  # fmt: skip


def joints(robot):
    """Return a strategy for joint values within the ranges."""
    return st.tuples(*(st.floats(low, high) for low, high in zip(robot.lower, robot.upper)))


def make_inverse(robot, number: int = 0, clock=time.monotonic, **settings):
    """Return the inverse kinematics of a robot; time does not press unless a test says so."""
    settings = {"budget_s": 60.0} | settings
    return inverse_kinematics(Chain(robot), IkSettings(**settings), np.random.default_rng(number), clock)


def assert_solves(chain, solution, pose, seed) -> None:
    """Check a solution: in range, on the pose, and what it says of itself."""
    chain.robot.check_range(solution.q)
    reached = chain.forward(solution.q)
    assert np.linalg.norm(reached.position - pose.position) <= 1e-6
    assert rotation_angle(reached.rotation, pose.rotation) <= 1e-6
    assert solution.residual_m <= 1e-6 and solution.residual_rad <= 1e-6
    np.testing.assert_allclose(solution.distance, np.linalg.norm(np.subtract(solution.q, seed)), atol=1e-12)


def assert_kept_or_refused(inverse, poses, slots) -> None:
    """Check that a configuration that is asked for is kept, or refused with those that there are."""
    kept = refused = 0
    for q, slot in itertools.product(poses, slots):
        pose, home = inverse.chain.forward(q), inverse.chain.robot.home
        try:
            solution = inverse.nearest(pose, home, slot)
        except BranchError as error:
            refused += 1
            assert error.available and str(slot) not in error.available
        else:
            kept += 1
            assert_solves(inverse.chain, solution, pose, home)
            assert solution.configuration == slot == inverse.configuration(solution.q)
    assert kept and refused
