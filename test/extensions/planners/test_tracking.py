"""Desired and actual motion: of one command, whatever the network takes."""

from __future__ import annotations

import pytest

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.extensions.planners.tracking import REST, Tracking


def twin_at(stamp: int, speed: float = 1.0) -> tuple[float, ...]:
    return (speed * stamp / 1e9, 0.5)


def moving(cycles: int, speed: float = 1.0, has_arm: bool = True) -> Tracking:
    tracking = Tracking(has_arm)
    for cycle in range(1, cycles + 1):
        tracking.on_twin(cycle * CYCLE_NS, twin_at(cycle * CYCLE_NS, speed))
    return tracking


def test_nothing_is_known_before_both_have_reported():
    tracking = Tracking(True)
    assert tracking.sample() is None
    tracking.on_arm((0.0, 0.5), 0)
    assert tracking.sample() is None
    assert moving(3).sample() is None


def test_a_delayed_pose_is_compared_with_the_twin_s_for_the_same_command():
    tracking = moving(50)
    stamp = 30 * CYCLE_NS
    tracking.on_arm(twin_at(stamp - CYCLE_NS), stamp)
    sample = tracking.sample()
    assert sample.stamp == stamp and sample.desired.position == pytest.approx(twin_at(stamp))
    # one cycle of servo lag is an error, 20 cycles of travel are none
    assert sample.error.position == pytest.approx((-CYCLE, 0.0), abs=1e-12)


def test_velocities_are_differences_between_two_samples():
    tracking, looks = Tracking(True), []
    for cycle in range(1, 31):
        stamp = cycle * CYCLE_NS
        seconds = stamp / 1e9
        tracking.on_twin(stamp, (seconds**2, 0.5))
        tracking.on_arm((2.0 * seconds**2, 0.5), stamp)
        if cycle % 5 == 0:
            looks.append(tracking.sample())
    last = looks[-1]
    assert last.desired.velocity == pytest.approx((0.10 + 0.12, 0.0))
    assert tracking.sample() is last


def test_without_an_arm_the_twin_is_the_arm():
    sample = moving(10, has_arm=False).sample()
    assert sample.actual == sample.desired and sample.error.position == (0.0, 0.0)


def test_a_pose_that_answers_to_no_command_is_compared_with_the_present_one():
    tracking = moving(10)
    tracking.on_arm((0.0, 0.5), 0)
    assert tracking.sample().desired.position == twin_at(10 * CYCLE_NS)


def test_the_twin_is_at_rest_when_its_pose_has_stayed_the_same():
    tracking = moving(10)
    assert not tracking.at_rest
    for cycle in range(11, 11 + REST // CYCLE_NS):
        assert not tracking.at_rest
        tracking.on_twin(cycle * CYCLE_NS, twin_at(10 * CYCLE_NS))
    assert tracking.at_rest
    assert not Tracking(True).at_rest


def resting(since: int, cycles: int) -> Tracking:
    """A twin that moves, and rests from the cycle `since` on."""
    tracking = moving(since)
    for cycle in range(since + 1, since + cycles + 1):
        tracking.on_twin(cycle * CYCLE_NS, twin_at(since * CYCLE_NS))
    return tracking


def test_an_arm_that_still_answers_to_the_motion_is_not_settled():
    tracking = resting(50, 10)
    assert tracking.at_rest and not tracking.settled
    # 100 ms before the end: the arm is where the twin was, and that is no success
    tracking.on_arm(twin_at(25 * CYCLE_NS), 25 * CYCLE_NS)
    assert tracking.sample().error.position == (0.0, 0.0) and not tracking.settled
    tracking.on_arm(twin_at(49 * CYCLE_NS), 49 * CYCLE_NS)
    assert not tracking.settled
    tracking.on_arm(twin_at(50 * CYCLE_NS), 50 * CYCLE_NS)
    assert tracking.settled


def test_a_twin_that_moves_is_not_settled():
    tracking = moving(50)
    tracking.on_arm(twin_at(50 * CYCLE_NS), 50 * CYCLE_NS)
    assert not tracking.settled


def test_a_pose_that_answers_to_no_command_counts_when_it_came_after_the_twin_was_at_rest():
    tracking = resting(50, 3)
    tracking.on_arm(twin_at(50 * CYCLE_NS), 0)
    for cycle in range(54, 60):
        tracking.on_twin(cycle * CYCLE_NS, twin_at(50 * CYCLE_NS))
    assert tracking.at_rest and not tracking.settled
    tracking.on_arm(twin_at(50 * CYCLE_NS), 0)
    assert tracking.settled


def test_without_an_arm_the_twin_alone_settles():
    tracking = Tracking(False)
    for cycle in range(1, 11):
        assert tracking.settled == tracking.at_rest
        tracking.on_twin(cycle * CYCLE_NS, twin_at(0))
    assert tracking.settled


def test_a_twin_whose_stamps_begin_anew_is_followed_anew():
    tracking = resting(50, 10)
    tracking.on_arm(twin_at(50 * CYCLE_NS), 50 * CYCLE_NS)
    assert tracking.sample().stamp == 50 * CYCLE_NS and tracking.settled
    tracking.on_twin(CYCLE_NS, (2.0, 0.5))
    assert not tracking.at_rest and not tracking.settled and tracking.sample() is None
    tracking.on_arm((2.0, 0.5), CYCLE_NS)
    sample = tracking.sample()
    assert (sample.stamp, sample.desired.position, sample.actual.velocity) == (CYCLE_NS, (2.0, 0.5), (0.0, 0.0))
    for cycle in range(2, 8):
        tracking.on_twin(cycle * CYCLE_NS, (2.0, 0.5))
    assert tracking.at_rest and tracking.settled


def test_a_pose_that_is_heard_twice_changes_nothing():
    tracking = resting(50, 10)
    tracking.on_twin(60 * CYCLE_NS, twin_at(50 * CYCLE_NS))
    assert tracking.at_rest
