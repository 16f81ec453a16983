"""Inverse kinematics by search (tried on an arm that has a closed form, and on two of seven joints) and along a linear axis."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_cases import (
    IIWA_LIKE,
    PANDA_LIKE,
    TRACK,
    UR_LIKE,
    assert_kept_or_refused,
    assert_solves,
    joints,
    make_inverse,
)

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.closed_form import SLOTS
from construction_twin.kinematics.inverse import IkSettings
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.solution import NotFoundError, OrientationError, PositionRangeError, UnreachableError
from construction_twin.robot.frames import abc_to_rotation


def search_of(robot, number=0, clock=time.monotonic, **settings):
    """Return the search for a robot, whether or not the robot has a closed form."""
    settings = {"budget_s": 60.0} | settings
    return NumericInverse(Chain(robot), IkSettings(**settings), np.random.default_rng(number), clock)


UR = search_of(UR_LIKE)
SEVEN = {robot.name: make_inverse(robot, patience=8) for robot in (PANDA_LIKE, IIWA_LIKE)}
RAIL = make_inverse(TRACK)
EYE = np.eye(3)


@given(joints(UR_LIKE), joints(UR_LIKE))
@settings(max_examples=40, deadline=None)
def test_every_reachable_pose_of_an_arm_without_a_spherical_wrist_is_solved(q, seed):
    pose = UR.chain.forward(q)
    assert_solves(UR.chain, UR.nearest(pose, seed), pose, seed)


@pytest.mark.parametrize("name", SEVEN)
def test_poses_of_an_arm_of_seven_joints_are_solved(name):
    inverse = SEVEN[name]
    robot = inverse.chain.robot
    assert isinstance(inverse, NumericInverse) and "neither six revolute ones nor a prismatic one" in inverse.kind.why
    for q, seed in np.random.default_rng(1).uniform(robot.lower, robot.upper, (8, 2, 7)):
        pose = inverse.chain.forward(q)
        found = inverse.nearest(pose, seed)
        assert_solves(inverse.chain, found, pose, seed)
        # the arm has slid until no motion brings it nearer, or a range ends
        along = np.linalg.svd(inverse.chain.jacobian(found.q))[2][6]
        at_end = (found.q < np.array(robot.lower) + 1e-3) | (found.q > np.array(robot.upper) - 1e-3)
        assert abs((found.q - seed) @ along) < 5e-3 or at_end.any()


@pytest.mark.parametrize("name", SEVEN)
def test_all_of_an_arm_of_seven_joints_offers_others_along_the_self_motion(name):
    inverse = SEVEN[name]
    robot = inverse.chain.robot
    pose, seed = inverse.chain.forward(0.5 * np.add(robot.home, robot.upper)), np.array(robot.home)
    solutions = inverse.all(pose, seed)
    assert [one.distance for one in solutions] == sorted(one.distance for one in solutions)
    for one in solutions:
        assert_solves(inverse.chain, one, pose, seed)
    assert solutions[0].distance <= inverse.nearest(pose, seed).distance + 0.05
    # so that whoever avoids contacts can choose: also postures that are far apart
    assert len(solutions) > 8 and max(math.dist(solutions[0].q, one.q) for one in solutions) > 1.0


@given(joints(TRACK), joints(TRACK))
@settings(max_examples=60, deadline=None)
def test_every_reachable_pose_on_the_track_is_solved_near_the_seed(q, seed):
    pose = RAIL.chain.forward(q)
    solution = RAIL.nearest(pose, seed)
    assert_solves(RAIL.chain, solution, pose, seed)
    # at a singularity two configurations are one
    if np.linalg.svd(RAIL.chain.jacobian(solution.q)[:, 1:], compute_uv=False)[-1] > 1e-3:
        assert solution.configuration == RAIL.configuration(solution.q)


@pytest.mark.parametrize("inverse", [UR, RAIL], ids=["ur_like", "track"])
def test_no_solution_known_is_nearer(inverse):
    robot = inverse.chain.robot
    for q, seed in np.random.default_rng(7).uniform(robot.lower, robot.upper, (60, 2, len(robot.lower))):
        solution = inverse.nearest(inverse.chain.forward(q), seed)
        assert solution.distance <= np.linalg.norm(q - seed) + 1e-5


@pytest.mark.parametrize("inverse", [UR, RAIL, *SEVEN.values()], ids=["ur_like", "track", *SEVEN])
def test_a_near_seed_is_kept(inverse):
    robot = inverse.chain.robot
    rng = np.random.default_rng(8)
    for q in rng.uniform(np.array(robot.lower) + 0.02, np.array(robot.upper) - 0.02, (20, len(robot.lower))):
        if np.linalg.svd(inverse.chain.jacobian(q), compute_uv=False)[-1] > 0.1:
            seed = q + rng.uniform(-0.002, 0.002, len(q))
            assert inverse.nearest(inverse.chain.forward(q), seed).distance <= np.linalg.norm(q - seed) + 1e-6


def test_the_track_helps_where_the_arm_alone_does_not_reach():
    pose = RAIL.chain.forward([0.9, 0.1, -0.6, 0.5, 0.1, 0.8, 0.0])
    middle = replace(TRACK, lower=(-0.01, *TRACK.lower[1:]), upper=(0.01, *TRACK.upper[1:]))
    with pytest.raises(UnreachableError) as caught:
        make_inverse(middle, budget_s=0.0).nearest(pose, TRACK.home)
    assert 0.0 < caught.value.missing < 0.9
    assert RAIL.nearest(pose, TRACK.home).q[0] > 0.01


@pytest.mark.parametrize("a5", [0.0, 1e-8, 3e-7, 1e-6, 1e-4, 1e-2])
def test_singular_wrist_on_the_track_is_kept(a5):
    for q in np.random.default_rng(3).uniform(TRACK.lower, TRACK.upper, (20, 7)):
        q[5] = a5
        assert RAIL.nearest(RAIL.chain.forward(q), q).distance < 1e-6


def test_a_singular_wrist_elsewhere_on_the_track_is_found():
    for q in np.random.default_rng(3).uniform(TRACK.lower, TRACK.upper, (40, 7)):
        q[5] = 0.0
        seed = q - [math.copysign(0.3, q[0]), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        assert RAIL.nearest(RAIL.chain.forward(q), seed).distance < 0.3 + 1e-5


def test_configuration_on_the_track_is_kept_or_refused():
    assert_kept_or_refused(RAIL, np.random.default_rng(12).uniform(TRACK.lower, TRACK.upper, (3, 7)), SLOTS)


@given(st.floats(0.001, 30.0))
def test_target_beyond_all_links_in_a_line_says_by_how_much(beyond):
    pose = Pose(UR.chain.shoulder + [0.0, UR.chain.reach + beyond, 0.0], EYE)
    with pytest.raises(UnreachableError) as caught:
        UR.nearest(pose, UR_LIKE.home)
    assert caught.value.missing == pytest.approx(beyond)


def test_search_does_not_call_impossible_what_it_did_not_find():
    # stretched out level: 0.61 + 0.57 + 0.12 to the side of 0.17 and 0.12 more at the last wrist
    pose = Pose(np.array([1.6, 0.0, 0.18]), EYE)
    with pytest.raises(NotFoundError, match="in the time given .*may still be reachable") as caught:
        search_of(UR_LIKE, seeds=10).nearest(pose, UR_LIKE.home)
    assert caught.value.tried == 10 and "nearest position found was" in caught.value.hint
    with pytest.raises(UnreachableError):  # the closed form knows all branches, so it can tell
        make_inverse(UR_LIKE).nearest(pose, UR_LIKE.home)


def narrow(robot, joint, low, high):
    lower, upper, home = list(robot.lower), list(robot.upper), list(robot.home)
    lower[joint], upper[joint], home[joint] = low, high, min(max(home[joint], low), high)
    return replace(robot, lower=tuple(lower), upper=tuple(upper), home=tuple(home))


def test_search_says_which_joint_its_solutions_are_out_of_range_by():
    robot = narrow(narrow(UR_LIKE, 5, -0.2, 0.2), 4, -3.2, 3.2)
    pose = Chain(UR_LIKE).forward([0.3, -1.2, 1.1, 0.2, 1.5, 2.0])
    with pytest.raises(
        NotFoundError, match=r"with wrist_3 at .* deg it would be, outside its range -11\.459156 deg to 11\.459156 deg"
    ):
        search_of(robot, seeds=40).nearest(pose, robot.home)
    with pytest.raises(OrientationError) as caught:
        make_inverse(robot).nearest(pose, robot.home)
    assert caught.value.joint == "wrist_3" and (caught.value.lower, caught.value.upper) == (-0.2, 0.2)


def test_closed_form_names_the_joint_that_the_position_needs():
    robot = narrow(UR_LIKE, 0, -0.1, 0.1)
    pose = Chain(UR_LIKE).forward([1.6, -0.3, 0.4, 0.2, 1.5, 0.3])
    with pytest.raises(PositionRangeError) as caught:
        make_inverse(robot).nearest(pose, robot.home)
    assert caught.value.joint == "pan"


def test_track_out_of_reach_says_by_how_much():
    pose = Pose(np.array([1.0 + 0.35 + 1.15 + math.hypot(1.0, 0.041) + 0.5, 0.0, 0.356 + 0.675 - 0.215]),
                abc_to_rotation(math.pi, 0.0, math.pi))  # fmt: skip
    with pytest.raises(UnreachableError) as caught:
        make_inverse(TRACK, budget_s=0.0).nearest(pose, TRACK.home)
    assert caught.value.missing == pytest.approx(0.5)


def test_budget_ends_the_search():
    ticks = itertools.count()
    inverse = search_of(UR_LIKE, clock=lambda: float(next(ticks)), budget_s=3.0, iterations=1)
    with pytest.raises(NotFoundError) as caught:
        inverse.nearest(UR.chain.forward([0.3, -1.2, 1.1, 0.2, 1.5, 2.0]), UR_LIKE.home)
    assert caught.value.tried == 3
    assert 0.0 < caught.value.residual_m < math.inf
