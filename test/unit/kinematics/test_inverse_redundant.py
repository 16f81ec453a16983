"""Seven joints of which one can be held: every reachable pose, ranges, the choice along the self-motion, no false verdicts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from inverse_cases import KR120, PANDA_LIKE, SEARCHED, TRACK, arm_of, assert_solves, joints, make_inverse

from construction_twin.core.motion_errors import (
    BranchError,
    JointRangeError,
    KinematicsError,
    NotFoundError,
    UnreachableError,
)
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.decomposition import NoClosedForm
from construction_twin.kinematics.inverse import Configuration
from construction_twin.kinematics.redundant import RedundantInverse, find_redundant

NONE = "0 0 0"
Z, Y = "0 0 1", "0 1 0"
#: Shoulder and wrist in a point each, an elbow between them: the kind of the iiwa.
ELBOWED = arm_of(
    "elbowed",
    [("0 0 .34", NONE, Z), (NONE, NONE, Y), ("0 0 .2", NONE, Z), ("0 0 .2", NONE, "0 -1 0"), ("0 0 .2", NONE, Z),
     ("0 0 .2", NONE, Y), (NONE, NONE, Z)],
    reach=2.9,
)  # fmt: skip
#: An arm of the OPW kind would be solved by `rail`; with the wrist to one side it has a closed form of another kind.
OBLIQUE_ON_TRACK = replace(
    TRACK,
    urdf=TRACK.urdf.replace(
        '<origin rpy="0 0 0" xyz="1.000 0 -0.041"/>', '<origin rpy="0 0 0.3" xyz="1.000 0 -0.041"/>'
    ),
)
ARMS = {"panda": PANDA_LIKE, "elbowed": ELBOWED}
INVERSES = {name: make_inverse(robot) for name, robot in ARMS.items()}
PANDA = INVERSES["panda"]


@pytest.mark.parametrize("name", ARMS)
def test_these_arms_have_one_redundant_joint(name):
    inverse = INVERSES[name]
    assert isinstance(inverse, RedundantInverse) and inverse.form.exact
    assert inverse.kind.name == "one redundant joint" and "with joint 7 held" in inverse.kind.why


@pytest.mark.parametrize("name", ARMS)
def test_every_reachable_pose_is_solved(name):
    inverse, robot = INVERSES[name], ARMS[name]

    @given(joints(robot), joints(robot))
    @settings(max_examples=80, deadline=None)
    def check(q, seed):
        pose = inverse.chain.forward(q)
        assert_solves(inverse.chain, inverse.nearest(pose, seed), pose, seed)

    check()


@pytest.mark.parametrize("name", ARMS)
def test_the_nearest_is_seldom_far_from_the_best_known(name):
    inverse, robot = INVERSES[name], ARMS[name]
    near = 0
    draws = np.random.default_rng(1).uniform(robot.lower, robot.upper, (60, 2, 7))
    for q, seed in draws:
        found = inverse.nearest(inverse.chain.forward(q), seed)
        near += found.distance <= 1.05 * np.linalg.norm(q - seed)
    assert near >= 0.97 * len(draws)


@pytest.mark.parametrize("name", ARMS)
def test_a_near_seed_is_kept(name):
    inverse, robot = INVERSES[name], ARMS[name]
    rng = np.random.default_rng(2)
    for q in rng.uniform(np.array(robot.lower) + 0.02, np.array(robot.upper) - 0.02, (30, 7)):
        seed = q + rng.uniform(-0.002, 0.002, 7)
        assert inverse.nearest(inverse.chain.forward(q), seed).distance <= np.linalg.norm(q - seed) + 1e-4


def test_the_arm_slides_until_no_motion_brings_it_nearer_or_a_range_ends():
    ended = 0
    draws = np.random.default_rng(3).uniform(PANDA_LIKE.lower, PANDA_LIKE.upper, (60, 2, 7))
    for q, seed in draws:
        found = PANDA.nearest(PANDA.chain.forward(q), seed).q
        along = np.linalg.svd(PANDA.chain.jacobian(found))[2][6]
        at_end = (np.abs(found - PANDA_LIKE.lower) < 1e-3) | (np.abs(found - PANDA_LIKE.upper) < 1e-3)
        ended += bool(abs((found - seed) @ along) < 2e-2 or at_end.any())
    assert ended >= 0.9 * len(draws)


@pytest.mark.parametrize("name", ARMS)
def test_all_offers_other_solutions_along_the_self_motion(name):
    inverse, robot = INVERSES[name], ARMS[name]
    q, seed = np.random.default_rng(4).uniform(0.6 * np.array(robot.lower), 0.6 * np.array(robot.upper), (2, 7))
    q = np.clip(q, np.array(robot.lower) + 0.1, np.array(robot.upper) - 0.1)
    pose = inverse.chain.forward(q)
    seed = np.clip(seed, robot.lower, robot.upper)
    solutions = inverse.all(pose, seed)
    assert len(solutions) > 8
    assert [one.distance for one in solutions] == sorted(one.distance for one in solutions)
    for one in solutions:
        assert_solves(inverse.chain, one, pose, seed)
    assert solutions[0].distance <= inverse.nearest(pose, seed).distance + 1e-4
    # so that whoever avoids contacts can choose: also postures that are far apart
    assert max(math.dist(solutions[0].q, one.q) for one in solutions) > 1.0


def test_a_range_that_leaves_little_room_is_kept():
    for joint in range(7):
        lower, upper, home = list(PANDA_LIKE.lower), list(PANDA_LIKE.upper), list(PANDA_LIKE.home)
        lower[joint], upper[joint] = home[joint] - 0.05, home[joint] + 0.05
        narrow = make_inverse(replace(PANDA_LIKE, lower=tuple(lower), upper=tuple(upper)))
        for q in np.random.default_rng(5).uniform(lower, upper, (6, 7)):
            pose = narrow.chain.forward(q)
            assert_solves(narrow.chain, narrow.nearest(pose, home), pose, home)


def test_an_arm_of_another_kind_on_a_linear_axis_is_solved_with_the_axis_held():
    inverse = make_inverse(OBLIQUE_ON_TRACK)
    assert isinstance(inverse, RedundantInverse) and inverse.held == 0
    for q, seed in np.random.default_rng(6).uniform(TRACK.lower, TRACK.upper, (15, 2, 7)):
        pose = inverse.chain.forward(q)
        assert_solves(inverse.chain, inverse.nearest(pose, seed), pose, seed)


@pytest.mark.parametrize(
    "robot, reason", [(KR120, "6 revolute and 0 prismatic"), (SEARCHED, "6 revolute and 0 prismatic")]
)
def test_other_numbers_of_joints_are_told_so(robot, reason):
    found = find_redundant(Chain(robot))
    assert isinstance(found, NoClosedForm) and reason in found.reason


def test_what_is_out_of_reach_says_by_how_much_and_the_rest_is_not_called_impossible():
    shoulder, reach = PANDA.chain.shoulder, PANDA.chain.reach
    with pytest.raises(UnreachableError) as caught:
        PANDA.nearest(Pose(shoulder + [0.0, 0.0, reach + 0.2], np.eye(3)), PANDA_LIKE.home)
    assert caught.value.missing == pytest.approx(0.2)
    hurried = make_inverse(PANDA_LIKE, seeds=5)
    with pytest.raises(NotFoundError, match="it may still be reachable"):
        hurried.nearest(Pose(shoulder + [0.0, 0.0, reach - 0.01], np.eye(3)), PANDA_LIKE.home)


@pytest.mark.parametrize("ask", [PANDA.nearest, PANDA.all])
def test_bad_seeds_poses_and_configurations_are_refused(ask):
    home = PANDA.chain.forward(PANDA_LIKE.home)
    with pytest.raises(JointRangeError, match="turn_1"):
        ask(home, (9.0, *PANDA_LIKE.home[1:]))
    with pytest.raises(KinematicsError, match="finite"):
        ask(Pose(np.array([math.nan, 0.0, 0.0]), np.eye(3)), PANDA_LIKE.home)
    with pytest.raises(BranchError, match="no meaning"):
        ask(home, PANDA_LIKE.home, Configuration.parse("up"))
