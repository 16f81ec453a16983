"""The kinematic twin: takes over the arm's pose, then executes exactly what it is told."""

from __future__ import annotations

import pytest

from construction_twin.twin import START_TOLERANCE, VirtualRobot

HOME, POSE = (0.0, 1.0), (0.5, -0.5)


def moved(q: tuple[float, ...], distance: float) -> tuple[float, ...]:
    return (q[0], q[1] + distance)


def test_shows_no_pose_before_it_has_taken_over_the_arm_s():
    twin = VirtualRobot(None)
    assert twin.pose is None
    assert not twin.execute(5, POSE)
    assert twin.pose is None
    assert twin.take_over(POSE)
    assert twin.pose == POSE


def test_takes_over_only_once():
    twin = VirtualRobot(None)
    twin.take_over(POSE)
    assert not twin.take_over(HOME)
    assert twin.pose == POSE


def test_without_an_arm_it_starts_at_home_and_takes_nothing_over():
    twin = VirtualRobot(HOME)
    assert twin.pose == HOME
    assert not twin.take_over(POSE)


def test_executes_a_command_exactly_with_its_stamp():
    twin = VirtualRobot(HOME)
    command = moved(HOME, 1e-4)
    assert twin.execute(4, command)
    assert (twin.pose, twin.stamp) == (command, 4)
    assert twin.execute(8, POSE)
    assert twin.pose == POSE


@pytest.mark.parametrize("stamp", [0, 7, 8])
def test_a_command_that_is_not_newer_is_not_executed(stamp):
    twin = VirtualRobot(HOME)
    twin.execute(8, HOME)
    assert not twin.execute(stamp, moved(HOME, 1e-4))
    assert (twin.pose, twin.stamp) == (HOME, 8)


def test_the_first_command_must_begin_at_the_pose_taken_over():
    twin = VirtualRobot(None)
    twin.take_over(POSE)
    assert not twin.execute(4, moved(POSE, START_TOLERANCE * 1.01))
    assert (twin.pose, twin.stamp) == (POSE, 0)
    assert twin.execute(4, moved(POSE, START_TOLERANCE * 0.99))


def test_a_restart_waits_for_the_arm_s_pose_and_drops_commands_still_on_their_way():
    twin = VirtualRobot(HOME)
    twin.execute(100, HOME)
    twin.restart()
    assert twin.pose is None and not twin.execute(104, HOME)
    assert twin.take_over(POSE)
    assert not twin.execute(108, HOME)
    assert twin.pose == POSE


def test_after_a_restart_a_clock_that_was_set_back_does_no_harm():
    twin = VirtualRobot(HOME)
    twin.execute(10**18, HOME)
    twin.restart()
    twin.take_over(POSE)
    assert twin.execute(4, POSE)
