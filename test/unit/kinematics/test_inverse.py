"""Inverse kinematics in closed form: all branches, turns, singular and limit cases of the KR 120, and every typed error."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from inverse_cases import (
    KR120,
    PANDA_LIKE,
    SEARCHED,
    TRACK,
    UR_LIKE,
    assert_kept_or_refused,
    assert_solves,
    joints,
    make_inverse,
)

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.closed_form import SLOTS, ClosedFormInverse
from construction_twin.kinematics.inverse import Configuration, inverse_kinematics
from construction_twin.kinematics.solution import OrientationError, PositionRangeError, UnreachableError
from construction_twin.robot.frames import abc_to_rotation
from construction_twin.robot.motion_errors import JointRangeError, KinematicsError

INVERSE = make_inverse(KR120)
CHAIN = INVERSE.chain
DOWN = abc_to_rotation(math.pi, 0.0, math.pi)


def pose_of(q_deg):
    return CHAIN.forward(np.radians(q_deg))


def test_the_kr120_is_solved_in_closed_form():
    assert isinstance(INVERSE, ClosedFormInverse)


@given(joints(KR120), joints(KR120))
def test_every_reachable_pose_is_solved_nearest_first(q, seed):
    pose = CHAIN.forward(q)
    solution = INVERSE.nearest(pose, seed)
    assert_solves(CHAIN, solution, pose, seed)
    # the joint values that made the pose are a solution, too: the nearest one is no further
    assert solution.distance <= np.linalg.norm(np.subtract(q, seed)) + 1e-3


@given(joints(KR120), joints(KR120))
def test_all_begins_with_the_nearest_and_is_in_order(q, seed):
    pose = CHAIN.forward(q)
    solutions = INVERSE.all(pose, seed)
    for solution in solutions:
        assert_solves(CHAIN, solution, pose, seed)
    distances = [solution.distance for solution in solutions]
    assert distances == sorted(distances)
    assert distances[0] == pytest.approx(INVERSE.nearest(pose, seed).distance, abs=1e-6)
    for one, other in itertools.combinations(solutions, 2):
        assert np.abs(one.q - other.q).max() > 1e-6


@given(joints(KR120))
def test_the_seed_s_own_pose_gives_the_seed(q):
    np.testing.assert_allclose(INVERSE.nearest(CHAIN.forward(q), q).distance, 0.0, atol=2e-3)


def test_all_knows_every_whole_turn_of_every_branch():
    q = np.radians([10, -80, 100, 20, 60, -45])
    found = {tuple(np.round(np.degrees(solution.q), 6) + 0.0) for solution in INVERSE.all(CHAIN.forward(q), q)}
    turns = {(10.0, -80.0, 100.0, a4, 60.0, a6) for a4 in (20.0, -340.0) for a6 in (-45.0, 315.0)}
    flipped = {(10.0, -80.0, 100.0, a4, -60.0, a6) for a4 in (200.0, -160.0) for a6 in (135.0, -225.0)}
    assert turns | flipped <= found


def test_branches_are_those_of_many_starts_of_another_solver():
    from construction_twin.kinematics.inverse import IkSettings
    from construction_twin.kinematics.numeric import NumericInverse

    search = NumericInverse(CHAIN, IkSettings(patience=60, budget_s=60.0), np.random.default_rng(3), lambda: 0.0)
    for q in np.random.default_rng(4).uniform(KR120.lower, KR120.upper, (8, 6)):
        seed = np.array(KR120.home)
        mine, theirs = INVERSE.all(CHAIN.forward(q), seed), search.all(CHAIN.forward(q), seed)
        assert len(mine) == len(theirs)
        for one, other in zip(mine, theirs):
            assert one.distance == pytest.approx(other.distance, abs=1e-3)


@pytest.mark.parametrize(
    "q_deg", [(0, -90, 90, 340, 60, -330), (0, -90, 90, -340, 60, 330), (170, -90, 90, 0, 60, 200)]
)
def test_the_seed_s_turn_is_kept(q_deg):
    q = np.radians(q_deg)
    np.testing.assert_allclose(INVERSE.nearest(CHAIN.forward(q), q).q, q, atol=1e-9)


def test_it_turns_back_where_the_next_turn_is_out_of_range():
    pose = pose_of([0, -90, 90, 0, 60, 10])  # A6 = 370 would be nearest
    seed = np.radians([0, -90, 90, 0, 60, 345])
    solution = INVERSE.nearest(pose, seed, Configuration.parse("positive"))
    assert math.degrees(solution.q[5]) == pytest.approx(10.0)


@pytest.mark.parametrize("ends", list(itertools.product((0, 1), repeat=6)))
def test_poses_on_the_very_edge_of_all_ranges(ends):
    q = np.array([(low, high)[end] for low, high, end in zip(KR120.lower, KR120.upper, ends)])
    pose = CHAIN.forward(q)
    assert_solves(CHAIN, INVERSE.nearest(pose, q), pose, q)
    assert_solves(CHAIN, INVERSE.nearest(pose, KR120.home), pose, KR120.home)


@given(joints(KR120), joints(KR120), st.floats(-1e-5, 1e-5) | st.just(0.0))
def test_singular_wrist_is_solved_and_moves_no_more_than_needed(q, seed, a5):
    q = (*q[:4], a5, q[5])
    pose = CHAIN.forward(q)
    solution = INVERSE.nearest(pose, seed)
    assert_solves(CHAIN, solution, pose, seed)
    assert solution.distance <= np.linalg.norm(np.subtract(q, seed)) + 1e-3


@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-1.0, 1.0))
def test_singular_wrist_shares_the_turn_between_a4_and_a6(a4, a6, missing):
    q = np.array([0.2, -1.6, 1.5, a4, 0.0, a6])
    seed = q.copy()
    q[5] += missing
    solution = INVERSE.nearest(CHAIN.forward(q), seed)
    assert solution.q[[3, 5]] == pytest.approx([a4 + missing / 2, a6 + missing / 2], abs=1e-6)


def test_at_a_singular_wrist_a_joint_at_its_end_leaves_the_turn_to_the_other():
    q = np.radians([0, -90, 90, 350, 0, 20])
    seed = np.radians([0, -90, 90, 350, 0, 0])
    assert np.degrees(INVERSE.nearest(CHAIN.forward(q), seed).q[[3, 5]]) == pytest.approx([350, 20], abs=1e-5)


def test_all_of_a_singular_wrist_are_separate_families():
    pose = pose_of([0, -90, 90, 0, 0, 30])
    solutions = INVERSE.all(pose, KR120.home, Configuration.parse("front up"))
    totals = [round(math.degrees(solution.q[3] + solution.q[5])) for solution in solutions]
    assert len(totals) == len(set(totals)) and 30 in totals and 390 in totals


def stretched(a3_offset):
    """Return joint values with upper arm and forearm (to the wrist centre) in one line, bent by an offset."""
    return np.array([0.3, -1.2, -math.atan2(0.041, 1.0) + a3_offset, 0.4, 0.8, -0.2])


@pytest.mark.parametrize("offset", [0.0, 1e-12, -1e-12, 1e-9, 1e-7, -1e-7, 1e-5, 1e-3])
def test_arm_stretched_to_the_very_edge_of_its_reach(offset):
    q = stretched(offset)
    pose = CHAIN.forward(q)
    for seed in (q, KR120.home):
        assert_solves(CHAIN, INVERSE.nearest(pose, seed), pose, seed)


@pytest.mark.parametrize("offset", [0.0, 1e-12, -1e-12, 1e-9, 1e-8, 1e-6])
def test_stretched_elbow_is_kept_whatever_the_other_shoulder_reaches(offset):
    rng = np.random.default_rng(1)
    for q in rng.uniform(KR120.lower, KR120.upper, (80, 6)):
        q[2] = stretched(offset)[2]
        if abs(math.sin(q[4])) > 0.05:
            assert INVERSE.nearest(CHAIN.forward(q), q).distance < 1e-3


@pytest.mark.parametrize("offset", [0.0, 1e-12, 1e-9])
def test_stretched_elbow_and_singular_wrist_at_once_are_kept(offset):
    for q in np.random.default_rng(2).uniform(KR120.lower, KR120.upper, (40, 6)):
        q[[2, 4]] = stretched(offset)[2], 0.0
        assert INVERSE.nearest(CHAIN.forward(q), q).distance < 1e-3


@pytest.mark.parametrize("a4, a6", list(itertools.product((350.0, -350.0, 0.0), repeat=2)))
def test_singular_wrist_at_the_very_ends_of_a4_and_a6_is_kept(a4, a6):
    for q in np.random.default_rng(3).uniform(KR120.lower, KR120.upper, (40, 6)):
        q[3:] = np.radians([a4, 0.0, a6])
        assert INVERSE.nearest(CHAIN.forward(q), q).distance < 1e-6


def test_singular_wrist_on_axis_1_is_kept():
    q = over_the_base()
    q[4] = 0.0
    assert INVERSE.nearest(CHAIN.forward(q), q).distance < 1e-3


@pytest.mark.parametrize("seed_a1", [0.0, 1.0, -2.0, 3.0])
def test_wrist_centre_on_axis_1_leaves_a1_near_the_seed(seed_a1):
    q = over_the_base()
    pose = CHAIN.forward(q)
    seed = np.array([seed_a1, *q[1:]])
    solution = INVERSE.nearest(pose, seed)
    assert_solves(CHAIN, solution, pose, seed)
    assert solution.distance <= abs(seed_a1 - 0.5) + 0.05
    assert INVERSE.all(pose, seed)[0].distance == solution.distance


def over_the_base():
    """Return joint values whose wrist centre is on axis 1: the forearm reaches back over the upper arm."""
    a2 = math.radians(-130.0)
    # 0.35 + 1.15 cos a2 + 1.0008 cos(a2 + a3 - psi) = 0, the forearm's angle a2 + a3 from the horizontal
    forearm = math.hypot(1.0, 0.041)
    angle = -math.acos(-(0.35 + 1.15 * math.cos(a2)) / forearm)
    return np.array([0.5, a2, angle - a2 - math.atan2(0.041, 1.0), 0.3, 0.7, 0.1])


@pytest.mark.parametrize("slot", SLOTS, ids=str)
def test_a_configuration_asked_for_is_kept_or_refused(slot):
    assert_kept_or_refused(INVERSE, np.random.default_rng(5).uniform(KR120.lower, KR120.upper, (60, 6)), [slot])


@given(joints(KR120))
def test_configuration_of_joint_values_is_that_of_their_branch(q):
    own = INVERSE.configuration(q)
    nearest = INVERSE.nearest(CHAIN.forward(q), q)
    if nearest.distance < 1e-6 and abs(q[4]) > 1e-3:
        assert nearest.configuration == own


def test_configurations_are_read_in_any_order_and_in_part():
    assert Configuration.parse("positive front up") == Configuration("front", "up", "positive")
    assert Configuration.parse("up") == Configuration(elbow="up")
    assert Configuration.parse("") == Configuration()
    assert str(Configuration.parse("negative back")) == "back negative"


@given(st.floats(0.001, 50.0), st.floats(-math.pi, math.pi))
def test_target_too_far_says_by_how_much(beyond, heading):
    # the wrist centre straight out from axis 2, level with it, 0.215 m behind the flange that points down
    distance = 0.350 + 1.150 + math.hypot(1.0, 0.041) + beyond
    pose = Pose(np.array([distance * math.cos(heading), distance * math.sin(heading), 0.675 - 0.215]), DOWN)
    with pytest.raises(UnreachableError, match="out of the arm's reach") as caught:
        INVERSE.nearest(pose, KR120.home)
    assert caught.value.missing == pytest.approx(beyond, rel=1e-9) and not caught.value.too_close


def test_target_too_close_says_by_how_much():
    # with axis 2 almost on axis 1 upper arm and forearm would have to be of one length to reach axis 2
    short = make_inverse(replace(KR120, urdf=KR120.urdf.replace('xyz="0.350 0 0"', 'xyz="0.02 0 0"')))
    assert short.model.a1 == pytest.approx(0.02)
    pose = Pose(np.array([0.02, 0.0, 0.675 - 0.215]), DOWN)
    with pytest.raises(UnreachableError, match="too close") as caught:
        short.all(pose, KR120.home)
    assert caught.value.missing == pytest.approx(1.150 - math.hypot(1.0, 0.041) - 0.04) and caught.value.too_close


def test_orientation_out_of_range_names_the_joint():
    narrow = make_inverse(
        replace(KR120, lower=(*KR120.lower[:4], -0.5, KR120.lower[5]), upper=(*KR120.upper[:4], 0.5, 6.1))
    )
    home = (*KR120.home[:4], 0.0, 0.0)
    with pytest.raises(OrientationError, match="orientation needs joint_a5") as caught:
        narrow.nearest(pose_of([0, -90, 90, 0, 90, 0]), home)
    assert caught.value.joint == "joint_a5"
    assert abs(caught.value.value) == pytest.approx(math.pi / 2)
    assert (caught.value.lower, caught.value.upper) == (-0.5, 0.5)


def test_position_out_of_range_names_the_joint():
    lower, upper = (math.radians(-10), *KR120.lower[1:]), (math.radians(10), *KR120.upper[1:])
    narrow = make_inverse(replace(KR120, lower=lower, upper=upper))
    with pytest.raises(PositionRangeError, match="position needs joint_a1") as caught:
        narrow.nearest(pose_of([60, -60, 70, 0, 80, 0]), KR120.home)
    assert math.degrees(caught.value.value) == pytest.approx(60.0)
    assert isinstance(caught.value, JointRangeError)


@pytest.mark.parametrize("ask", [INVERSE.nearest, INVERSE.all])
def test_seed_out_of_range_is_refused(ask):
    with pytest.raises(JointRangeError, match="joint_a2"):
        ask(CHAIN.forward(KR120.home), (0.0, 0.0, *KR120.home[2:]))


@pytest.mark.filterwarnings("error")  # refused before numpy computes with it
@pytest.mark.parametrize("ask", [INVERSE.nearest, INVERSE.all])
@pytest.mark.parametrize(
    "position, rotation, what",
    [
        ((math.nan, 0, 1), np.eye(3), "finite"),
        ((1, 0, 1), np.full((3, 3), math.inf), "finite"),
        ((1, 0, 1), np.diag([1.0, 1.0, -1.0]), "right-handed"),
        ((1.35, 0, 1.569), DOWN * 1.01, "orthonormal"),
    ],
)
def test_pose_that_is_none_is_refused(ask, position, rotation, what):
    with pytest.raises(KinematicsError, match=what):
        ask(Pose(np.array(position, dtype=float), rotation), KR120.home)


@pytest.mark.parametrize(
    "robot, kind, why",
    [
        (KR120, "OPW", "axes 2 and 3 are parallel"),
        (UR_LIKE, "closed form", "axes 2, 3 and 4 are parallel and axes 5 and 6 meet in a point"),
        (TRACK, "OPW on a linear axis", "behind joint 1, which is prismatic"),
        (PANDA_LIKE, "search", "its joints are neither six revolute ones nor"),
        (SEARCHED, "search", "it has no closed form: no three neighbouring axes"),
    ],
)
def test_every_arm_is_told_its_kind_and_why(robot, kind, why):
    found = inverse_kinematics(Chain(robot)).kind
    assert found.name == kind and re.search(why, found.why)
