"""Poses that are left out at rest, and none that anybody would miss; velocities as differences of poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene_samples import kr120

from construction_twin.ros.nodes.display import REST_PERIOD, STILL, JointVelocities, ShownPoses

NAMES = ("a", "b")
#: Between two poses [s]; sums of it are exact.
PERIOD = 1 / 32
#: Between two poses with velocities [ns].
CYCLE = 20_000_000
HOME = kr120().home
LARGEST = kr120().velocity


def shown(*q: float) -> list[int]:
    """Return which poses of a stream are shown, by their number, in the order of being shown."""
    poses: ShownPoses[int] = ShownPoses()
    taken = [poses.next_shown(number * PERIOD, NAMES, (value, 0.0), number) for number, value in enumerate(q)]
    return [number for number in taken if number is not None]


def test_in_motion_each_pose_is_shown():
    assert shown(*(0.001 * number for number in range(20))) == list(range(20))


def test_at_rest_a_few_a_second_are_shown():
    assert shown(*[1.0] * 26) == [0, 7, 14, 21]


def test_a_motion_begins_where_the_rest_ended():
    """Then tf draws no line from a pose that was long ago."""
    assert shown(0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.3, 0.3) == [0, 2, 4, 5]


def test_a_motion_of_a_pose_right_after_one_that_was_shown_is_shown_at_once():
    assert shown(0.0, 0.1) == [0, 1]


def test_a_single_step_is_shown_with_the_next_pose():
    assert shown(0.0, 0.0, 0.5, 0.5) == [0, 1, 3]


def test_an_arm_that_trembles_rests_and_one_that_creeps_moves():
    tremble = [0.9 * STILL * (number % 2) for number in range(26)]
    assert len(shown(*tremble)) == 4
    creep = [0.4 * STILL * number for number in range(26)]
    assert len(shown(*creep)) > 4


@pytest.mark.parametrize("names, q", [(("a", "c"), (0.0, 0.0)), (("a",), (0.0,)), (NAMES, (0.0,))])
def test_what_another_publisher_says_of_other_joints_is_shown(names, q):
    poses: ShownPoses[str] = ShownPoses()
    assert poses.next_shown(0.0, NAMES, (0.0, 0.0), "first") == "first"
    assert (poses.next_shown(0.01, names, q, "other") == "other") == (names != NAMES)


@given(st.lists(st.sampled_from([0.0, 0.5 * STILL, 0.1, 0.2]), max_size=60))
def test_what_is_shown_is_never_far_from_the_truth_for_longer_than_two_poses_nor_old(values):
    poses: ShownPoses[int] = ShownPoses()
    last, seen_at, off = None, 0.0, 0
    for number, value in enumerate(values):
        taken = poses.next_shown(number * PERIOD, NAMES, (value, 0.0), number)
        if taken is not None:
            assert last is None or taken > last, "in the order of time, and none twice"
            last, seen_at = taken, number * PERIOD
        assert last is not None
        off = off + 1 if abs(values[last] - value) > 2 * STILL else 0
        assert off <= 1
        assert number * PERIOD - seen_at <= REST_PERIOD


def test_velocities_are_those_of_the_motion():
    velocities = JointVelocities(LARGEST)
    for cycle in range(100):
        time = cycle * 0.02
        q = tuple(value + 0.1 * (number + 1) * math.sin(time) for number, value in enumerate(HOME))
        found = velocities.update(cycle * CYCLE, q)
        if cycle == 0:
            assert found == (0.0,) * 6
            continue
        # of the middle between the two poses
        expected = [0.1 * (number + 1) * math.cos(time - 0.01) for number in range(6)]
        np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_at_rest_they_are_zero():
    velocities = JointVelocities(LARGEST)
    assert [velocities.update(cycle * CYCLE, HOME) for cycle in range(3)] == [(0.0,) * 6] * 3


@pytest.mark.parametrize("stamp, offset", [(0, 0.001), (-5, 0.001), (CYCLE, 1.0)])
def test_a_pose_that_was_not_moved_to_is_at_rest(stamp, offset):
    """A stamp that is not newer; a twin that has taken the arm's pose over."""
    velocities = JointVelocities(LARGEST)
    velocities.update(0, HOME)
    q = tuple(value + offset for value in HOME)
    assert velocities.update(stamp, q) == (0.0,) * 6
    # and from there the motion goes on
    later = tuple(value + 0.001 for value in q)
    np.testing.assert_allclose(velocities.update(stamp + CYCLE, later), 0.05)


def test_the_robot_s_largest_speeds_tell_what_a_jump_is():
    velocities = JointVelocities((100.0,) * 6)
    velocities.update(0, HOME)
    np.testing.assert_allclose(velocities.update(CYCLE, tuple(value + 1.0 for value in HOME)), 50.0)
