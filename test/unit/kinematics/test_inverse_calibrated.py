"""Calibrated arms: their closed form is only near, and every pose that they reach is solved all the same."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from inverse_cases import arm_of, assert_solves, make_inverse

from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import OrientationError, PositionRangeError, refine, residual
from construction_twin.robot.motion_errors import KinematicsError

#: Origins, x, y, z [m] and roll, pitch, yaw [rad], of shoulder to wrist_3 of a UR10e (calib_14405667343136254952), by the file
#: left_ur10e_calibration.yaml of the repository bimanual_ur10e_motion_planner of Cable-Disentanglement-Workspace on GitHub.
UR10E = (
    ("0 0 0.18084157029328396", "0 0 -7.6824862013658013e-07"),
    ("0.00021879748431393822 0 0", "1.5702696486411614 0 3.311566481723608e-06"),
    ("-0.61247876620539021 0 0", "3.1406222753920905 3.1406655382359778 3.1415924280151986"),
    (
        "-0.57129689433904929 0.00037129939920217323 0.17452299191475026",
        "3.1394651468645987 -3.1404845441468892 -3.1415901372495783",
    ),
    (
        "4.1737580634203156e-05 -0.11988769700986908 1.1878378483917563e-06",
        "1.5707864188737506 0 -6.9876495680486206e-07",
    ),
    (
        "-6.4026247366765526e-06 0.11550521683538024 5.250966616796619e-05",
        "1.5712509353743984 3.1415926535897931 3.141592652034336",
    ),
)
#: Every axis is Z, and the range is two turns.
ARM = arm_of("UR10e", [(xyz, rpy, "0 0 1") for xyz, rpy in UR10E], tip="0 0 0", reach=2.0 * math.pi)
#: Joint values to be reached and seeds, shape (poses, 2, 6).
DRAWS = np.random.default_rng(0).uniform(ARM.lower, ARM.upper, (1500, 2, 6))
#: Some of them to which no branch of the nominal model leads.
WITHOUT_BRANCH = (383, 937, 1378)


def test_every_pose_that_a_calibrated_arm_reaches_is_solved():
    inverse = make_inverse(ARM)
    assert inverse.kind.name == "closed form" and "to within" in inverse.kind.why
    for q, seed in DRAWS[:400]:
        pose = inverse.chain.forward(q)
        assert_solves(inverse.chain, inverse.nearest(pose, seed), pose, seed)


def test_all_solutions_are_given_where_no_branch_of_the_nominal_model_leads_to_one():
    inverse = make_inverse(ARM)
    for number in WITHOUT_BRANCH:
        q, seed = DRAWS[number]
        pose = inverse.chain.forward(q)
        rows = [refine(inverse.chain, np.array(row), pose, 12, within=False) for row in inverse.branches(pose)[0]]
        solved = [inverse.is_solved(*residual(inverse.chain, row, pose)) for row in rows]
        assert rows and not any(solved), "a branch leads there, so this draw shows nothing"
        found = inverse.all(pose, seed)
        assert found
        for solution in found[:3]:
            assert_solves(inverse.chain, solution, pose, seed)


def test_a_pose_out_of_reach_or_range_still_says_so():
    inverse = make_inverse(ARM, budget_s=0.2)
    with pytest.raises(KinematicsError, match="reach"):
        inverse.nearest(Pose(np.array([2.0, 0.0, 0.3]), np.eye(3)), np.zeros(6))
    narrow = dataclasses.replace(ARM, lower=(*ARM.lower[:5], 0.1), upper=(*ARM.upper[:5], 0.2))
    pose = inverse.chain.forward([0.3, -1.2, 1.4, -0.7, 1.1, 2.5])
    with pytest.raises((OrientationError, PositionRangeError), match="joint_6"):
        make_inverse(narrow, budget_s=0.2).nearest(pose, [0.0, 0.0, 0.0, 0.0, 0.0, 0.15])
