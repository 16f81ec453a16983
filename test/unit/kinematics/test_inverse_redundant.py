"""Seven joints of which one can be held: every reachable pose, ranges, the choice along the self-motion, no false verdicts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fine_reference import fine_nearest
from hypothesis import given, settings
from inverse_cases import IIWA_LIKE, KR120, PANDA_LIKE, SEARCHED, TRACK, arm_of, assert_solves, joints, make_inverse

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
ARMS = {"panda": PANDA_LIKE, "iiwa": IIWA_LIKE, "elbowed": ELBOWED}
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


#: Poses of the Panda-like arm that are reached only on a short piece of a self-motion, and seeds: the search took tens of
#: milliseconds for them, or found nothing in its budget.
HARD = [
    ([-1.957497, 1.740965, 0.161448, -0.396417, -2.0971, 1.004982, -2.138789],
     [-0.591, 0.425, -0.947, -2.269, 1.663, 2.864, 0.983]),
    ([2.330626, 0.488928, -2.751737, -0.494108, 0.525766, 1.005418, 2.898593],
     [2.405, 0.535, -2.897, -1.198, -2.119, 1.886, -2.165]),
    ([-2.100815, 1.738769, -0.175414, -0.398846, 1.957546, 0.123913, -0.895616],
     [0.675, -1.071, -0.36, -1.912, -2.672, 3.352, 0.105]),
    ([0.423113, -1.70519, 2.388769, -0.535913, -2.157599, 1.940575, -2.884707],
     [2.164, -0.448, -1.226, -0.446, 2.016, 3.435, 0.209]),
    ([-2.212346, 0.217215, 0.622148, -0.431996, 0.094133, 2.289463, 1.247951],
     [-2.414, -1.562, -2.724, -2.749, -1.418, 0.162, 0.559]),
    ([2.04672, 0.504013, 0.594709, -0.922603, -0.525048, 2.806569, -2.761959],
     [2.514, 0.765, -2.832, -0.941, 0.46, 2.303, 0.867]),
    ([0.32989, -0.886329, -0.85601, -0.468066, -0.106672, 1.068099, 0.042184],
     [0.045, 0.784, 2.466, -0.536, 1.079, 1.908, 1.191]),
    ([0.859975, 0.346843, -0.99164, -2.979854, -1.460463, 2.341598, -1.476061],
     [1.903, 0.112, -2.194, -2.959, 2.481, 0.256, -1.559]),
]  # fmt: skip


@pytest.mark.parametrize("q, seed", HARD)
def test_a_pose_reached_on_a_short_piece_of_a_self_motion_needs_no_search(q, seed):
    # the search alone, from one starting point, finds none of them
    inverse = make_inverse(PANDA_LIKE, seeds=1, iterations=1)
    pose = inverse.chain.forward(q)
    assert_solves(inverse.chain, inverse.nearest(pose, seed), pose, seed)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("draw", [1, 2, 3])
def test_reachable_poses_of_any_seed_need_no_search(name, draw):
    robot = ARMS[name]
    inverse = make_inverse(robot, seeds=1, iterations=1)
    for q, seed in np.random.default_rng(draw).uniform(robot.lower, robot.upper, (60, 2, 7)):
        pose = inverse.chain.forward(q)
        assert_solves(inverse.chain, inverse.nearest(pose, seed), pose, seed)


@pytest.mark.parametrize("name", ["panda", "iiwa"])
def test_the_first_of_all_is_the_nearest_of_a_fine_division(name):
    inverse, robot = INVERSES[name], ARMS[name]
    draws = np.random.default_rng(1).uniform(robot.lower, robot.upper, (14, 2, 7))
    equal = 0
    for q, seed in draws:
        pose = inverse.chain.forward(q)
        equal += inverse.all(pose, seed)[0].distance <= fine_nearest(inverse, pose, seed) + 1e-4
    assert equal >= len(draws) - 2


@pytest.mark.parametrize("q2", [0.3, 0.02, 1e-4, 1e-7, 0.0])
def test_a_seed_near_a_hinge_is_kept_and_a_sweep_past_it_is_found(q2):
    # at joint 2 = 0 axes 1 and 3 are one line: the arm can turn joint 1 against joint 3 as far as it likes
    q = np.array([0.4, q2, -0.3, -1.6, 0.5, 1.7, 0.2])
    pose = PANDA.chain.forward(q)
    assert PANDA.nearest(pose, q).distance < 1e-6
    seed = q + [1.1, 0.0, -1.1, 0.0, 0.0, 0.0, 0.0]
    assert PANDA.all(pose, seed)[0].distance <= (fine_nearest(PANDA, pose, seed) if q2 > 0.01 else 0.0) + 1e-3


@pytest.mark.parametrize("name", ARMS)
def test_what_is_found_is_seldom_far_from_the_best_known(name):
    inverse, robot = INVERSES[name], ARMS[name]
    near = quick = 0
    draws = np.random.default_rng(1).uniform(robot.lower, robot.upper, (60, 2, 7))
    for q, seed in draws:
        pose, known = inverse.chain.forward(q), np.linalg.norm(q - seed)
        near += inverse.all(pose, seed)[0].distance <= 1.05 * known
        quick += inverse.nearest(pose, seed).distance <= 1.05 * known
    assert near >= 0.98 * len(draws)
    assert quick >= 0.9 * len(draws)


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
        ended += bool(abs((found - seed) @ along) < 5e-3 or at_end.any())
    assert ended >= 0.97 * len(draws)


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
