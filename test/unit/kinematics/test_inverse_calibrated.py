"""Calibrated arms: their closed form is only near, and every pose that they reach is solved all the same."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from inverse_cases import assert_solves, make_inverse
from ur_calibrations import UR5, UR5E, UR10E, calibrated

from construction_twin.core.motion_errors import KinematicsError, OrientationError, PositionRangeError
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import refine, residual

ARMS = {name: calibrated(name, origins) for name, origins in {"UR5": UR5, "UR5e": UR5E, "UR10e": UR10E}.items()}
#: Poses of each arm, as many as the figures of docs/planning.md.
POSES = 4000
#: Some of them to which no branch of the nominal model leads.
WITHOUT_BRANCH = {"UR5": (254, 521, 737), "UR5e": (7, 48, 129), "UR10e": (383, 937, 1378)}


def draws(robot, count: int = POSES):
    """Return joint values to be reached and seeds, shape (count, 2, 6)."""
    return np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, 2, 6))


@pytest.mark.parametrize("name", ARMS)
def test_every_pose_that_a_calibrated_arm_reaches_is_solved(name):
    inverse = make_inverse(ARMS[name])
    assert inverse.kind.name == "closed form" and "to within" in inverse.kind.why
    for q, seed in draws(ARMS[name]):
        pose = inverse.chain.forward(q)
        assert_solves(inverse.chain, inverse.nearest(pose, seed), pose, seed)


@pytest.mark.parametrize("name", ARMS)
def test_all_solutions_are_given_where_no_branch_of_the_nominal_model_leads_to_one(name):
    inverse = make_inverse(ARMS[name])
    drawn = draws(ARMS[name])
    for number in WITHOUT_BRANCH[name]:
        q, seed = drawn[number]
        pose = inverse.chain.forward(q)
        rows = [refine(inverse.chain, np.array(row), pose, 12, within=False) for row in inverse.branches(pose)]
        solved = [inverse.is_solved(*residual(inverse.chain, row, pose)) for row in rows]
        assert rows and not any(solved), "a branch leads there, so this draw shows nothing"
        found = inverse.all(pose, seed)
        assert found
        for solution in found[:3]:
            assert_solves(inverse.chain, solution, pose, seed)


def test_a_pose_out_of_reach_or_range_still_says_so():
    robot = ARMS["UR5"]
    inverse = make_inverse(robot, budget_s=0.2)
    with pytest.raises(KinematicsError, match="reach"):
        inverse.nearest(Pose(np.array([2.0, 0.0, 0.3]), np.eye(3)), np.zeros(6))
    narrow = dataclasses.replace(robot, lower=(*robot.lower[:5], 0.1), upper=(*robot.upper[:5], 0.2))
    pose = inverse.chain.forward([0.3, -1.2, 1.4, -0.7, 1.1, 2.5])
    with pytest.raises((OrientationError, PositionRangeError), match="joint_6"):
        make_inverse(narrow, budget_s=0.2).nearest(pose, [0.0, 0.0, 0.0, 0.0, 0.0, 0.15])
