"""The kinematic twin: takes over the arm's pose, then executes exactly what it is told."""

from __future__ import annotations

import pytest

from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.execution.executor import TWIN_TIMEOUT
from construction_twin.twin.virtual_robot import SILENCE, START_TOLERANCE, TwinClock, VirtualRobot

HOME, POSE = (0.0, 1.0), (0.5, -0.5)


def moved(q: tuple[float, ...], distance: float) -> tuple[float, ...]:
    return (q[0], q[1] + distance)


def test_shows_no_pose_before_it_has_taken_over_the_arm_s():
    twin = VirtualRobot(None)
    assert twin.pose is None
    assert not twin.execute(5, POSE)
    assert twin.pose is None
    assert twin.assume_pose(POSE)
    assert twin.pose == POSE


def test_without_an_arm_it_starts_at_home_and_takes_nothing_over():
    twin = VirtualRobot(HOME)
    assert twin.pose == HOME
    assert not twin.assume_pose(POSE)


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
    twin.assume_pose(POSE)
    assert not twin.execute(4, moved(POSE, START_TOLERANCE * 1.01))
    assert (twin.pose, twin.stamp) == (POSE, 0)
    assert twin.execute(4, moved(POSE, START_TOLERANCE * 0.99))


def test_a_restart_waits_for_the_arm_s_pose_and_drops_commands_still_on_their_way():
    twin = VirtualRobot(HOME)
    twin.execute(100, HOME)
    twin.restart()
    assert twin.pose is None and not twin.execute(104, HOME)
    assert twin.assume_pose(POSE)
    assert not twin.execute(108, HOME)
    assert twin.pose == POSE


class TestStamps:
    T0 = 1000 * CYCLE_NS

    def test_until_the_first_command_the_pose_is_repeated_by_the_clock(self):
        clock = TwinClock()
        assert all(clock.on_cycle(self.T0 + k * CYCLE_NS) for k in range(10))

    def test_while_commands_come_only_theirs_are_published(self):
        clock = TwinClock()
        for now in range(self.T0, self.T0 + NANOSECONDS, CYCLE_NS):
            assert clock.on_command(now, now)
            assert not clock.on_cycle(now + 1)

    def test_never_goes_back(self):
        clock = TwinClock()
        clock.on_command(self.T0, self.T0)
        shown = self.T0 + SILENCE
        assert clock.on_cycle(shown)
        assert not clock.on_command(self.T0 + CYCLE_NS, shown)
        assert not clock.on_command(shown, shown) and not clock.on_cycle(shown)
        assert clock.on_command(shown + 1, shown + 1)

    def test_the_executor_waits_longer_than_the_twin_is_silent(self):
        assert TWIN_TIMEOUT >= 2 * SILENCE

    def test_says_for_how_long_it_will_not_repeat(self):
        clock = TwinClock()
        assert clock.idle(self.T0) == 0
        clock.on_command(self.T0, self.T0)
        assert clock.idle(self.T0 + 1) == SILENCE - 1 and clock.idle(self.T0 + 2 * SILENCE) == 0
        # a clock that was set back says nothing of the future
        assert clock.idle(self.T0 - NANOSECONDS) == SILENCE
        clock.restart()
        assert clock.idle(self.T0) == 0
