"""Robots and checks that several tests of inverse kinematics use."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from rotations import rotation_angle

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.robot.description import read_robot_files

ROOT = Path(__file__).parents[2]
KR120 = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
UR_LIKE = read_robot_files(ROOT / "test/data/ur_like.urdf", ROOT / "test/data/ur_like.yaml")
TRACK = read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml")


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
