"""Six joints with a closed form of any kind: every branch, the nearest, arms that are only near a kind, and why there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ik_figures import Problem, brute_force
from inverse_cases import (
    SEARCHED,
    UR_LIKE,
    arm_of,
    assert_solves,
    changed,
    joints,
    make_inverse,
)
from scipy.spatial.transform import Rotation

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.solution import UnreachableOrientationError
from construction_twin.kinematics.subproblems import SubproblemInverse, find_closed_form
from construction_twin.robot.motion_errors import KinematicsError

Z, Y, X = "0 0 1", "0 1 0", "1 0 0"
NONE = "0 0 0"
#: Arms of different kinds: origin and axis of each joint.
ARMS = {
    "UR-like": UR_LIKE,
    "UR-like, angles of five digits": changed("elbow", rpy="0.000003 0 0.000003", robot=UR_LIKE),
    "2 and 3 parallel, axis 4 oblique": [
        ("0 0 .4", Z), (".1 0 0", Y), ("0 0 .6", Y), (".1 0 .5", "1 .3 0"), (NONE, Y), (NONE, X)
    ],
    "1 and 2 parallel": [("0 0 .4", Z), (".5 0 0", Z), (".4 0 0", Y), (".1 0 .5", X), (NONE, Y), (NONE, X)],
    "1 and 2 meet": [("0 0 .4", Z), (NONE, Y), (".5 .1 0", X), (".1 .4 .2", X), (NONE, Y), (NONE, X)],
    "shoulder in a point": [("0 0 .4", Z), (NONE, Y), (NONE, Z), ("0 .05 .5", Y), (".5 0 .1", Y), ("0 .1 .2", Z)],
    "1, 2 and 3 parallel": [("0 0 .4", Z), (".5 0 .1", Z), (".4 0 0", Z), (".1 0 0", X), ("0 0 .2", Y), (NONE, X)],
    "3, 4 and 5 parallel": [("0 0 .4", Z), (NONE, X), ("0 .1 .3", Y), ("0 0 .5", Y), (".3 0 .1", Y), (".1 .1 0", Z)],
}  # fmt: skip
ARMS = {
    name: arm_of("made", [(xyz, NONE, axis) for xyz, axis in arm]) if isinstance(arm, list) else arm
    for name, arm in ARMS.items()
}
INVERSES = {name: make_inverse(robot) for name, robot in ARMS.items()}
UR = INVERSES["UR-like"]


@pytest.mark.parametrize("name", ARMS)
def test_each_of_these_arms_has_an_exact_closed_form(name):
    inverse = INVERSES[name]
    assert isinstance(inverse, SubproblemInverse)
    assert inverse.kind.name == "closed form" and "axes" in inverse.kind.why


@pytest.mark.parametrize("name", ARMS)
def test_every_reachable_pose_is_solved_and_no_known_solution_is_nearer(name):
    inverse = INVERSES[name]

    @given(joints(ARMS[name]), joints(ARMS[name]))
    @settings(max_examples=40, deadline=None)
    def check(q, seed):
        pose = inverse.chain.forward(q)
        solution = inverse.nearest(pose, seed)
        assert_solves(inverse.chain, solution, pose, seed)
        if np.linalg.svd(inverse.chain.jacobian(q), compute_uv=False)[-1] > 1e-3:
            assert solution.distance <= np.linalg.norm(np.subtract(q, seed)) + 1e-5

    check()


@pytest.mark.parametrize("name", ARMS)
def test_the_nearest_is_the_one_that_a_brute_force_finds(name):
    inverse = INVERSES[name]
    search = brute_force(inverse.chain, np.random.default_rng(1), 60)
    robot = ARMS[name]
    for q, seed in np.random.default_rng(2).uniform(robot.lower, robot.upper, (3, 2, 6)):
        pose = inverse.chain.forward(q)
        assert inverse.nearest(pose, seed).distance <= search(Problem(pose, seed)) + 1e-5


@pytest.mark.parametrize("name", ARMS)
def test_all_are_in_order_apart_and_complete(name):
    inverse, robot = INVERSES[name], ARMS[name]
    q, seed = np.random.default_rng(3).uniform(robot.lower, robot.upper, (2, 6))
    pose = inverse.chain.forward(q)
    solutions = inverse.all(pose, seed)
    assert [one.distance for one in solutions] == sorted(one.distance for one in solutions)
    assert solutions[0].distance == pytest.approx(inverse.nearest(pose, seed).distance, abs=1e-9)
    for one in solutions:
        assert_solves(inverse.chain, one, pose, seed)
    found = np.array([one.q for one in solutions])
    solver = NumericInverse(inverse.chain, inverse.settings, np.random.default_rng(4), lambda: 0.0)
    for one in solver.all(pose, seed):
        assert np.abs(found - one.q).max(axis=1).min() < 1e-3


@given(joints(UR_LIKE), joints(UR_LIKE), st.sampled_from([0.0, 1e-9, 1e-7, math.pi]))
@settings(max_examples=25, deadline=None)
def test_singular_wrists_are_solved(q, seed, wrist):
    q = (*q[:4], wrist, q[5])
    pose = UR.chain.forward(q)
    assert_solves(UR.chain, UR.nearest(pose, seed), pose, seed)


@pytest.mark.parametrize("elbow", [0.0, 1e-9, -1e-9, 1e-7, 1e-5])
def test_a_stretched_elbow_is_solved_and_kept(elbow):
    for q in np.random.default_rng(5).uniform(UR_LIKE.lower, UR_LIKE.upper, (20, 6)):
        q[2] = elbow
        pose = UR.chain.forward(q)
        solution = UR.nearest(pose, q)
        assert_solves(UR.chain, solution, pose, q)
        assert solution.distance < 1e-3


@pytest.mark.parametrize("robot", [SEARCHED, changed("elbow", rpy="0.004 0 0.003", robot=UR_LIKE)])
def test_an_arm_of_no_kind_is_told_what_is_missing(robot):
    inverse = make_inverse(robot)
    assert isinstance(inverse, NumericInverse) and inverse.kind.why == find_closed_form(Chain(robot))
    assert "no three neighbouring axes are parallel" in inverse.kind.why


def test_a_position_within_reach_in_no_such_orientation_says_so():
    rng = np.random.default_rng(8)
    stretched = UR.chain.forward([0.0, 0.0, 0.2, 0.0, 0.3, 0.0])
    seen = set()
    for quaternion in rng.normal(size=(40, 4)):
        turned = Pose(stretched.position, Rotation.from_quat(quaternion).as_matrix())
        try:
            UR.nearest(turned, UR_LIKE.home)
        except KinematicsError as error:
            seen.add(type(error))
            assert str(error) == "the target's position can be reached, but not with its orientation: turn the target"
    assert seen == {UnreachableOrientationError}
