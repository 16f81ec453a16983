"""Velocities as differences of the twin's poses; the node around them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scene_samples import kr120

from construction_twin.core.units import NANOSECONDS
from construction_twin.robot.joint_velocities import JointVelocities
from construction_twin.ros.nodes.joint_velocities import JointVelocitiesNode

PERIOD = 20_000_000
HOME = kr120().home
LARGEST = kr120().velocity


def test_velocities_are_those_of_the_motion():
    velocities = JointVelocities(LARGEST)
    for cycle in range(100):
        time = cycle * 0.02
        q = tuple(value + 0.1 * (number + 1) * math.sin(time) for number, value in enumerate(HOME))
        found = velocities.of(cycle * PERIOD, q)
        if cycle == 0:
            assert found == (0.0,) * 6
            continue
        # of the middle between the two poses
        expected = [0.1 * (number + 1) * math.cos(time - 0.01) for number in range(6)]
        np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_at_rest_they_are_zero():
    velocities = JointVelocities(LARGEST)
    assert [velocities.of(cycle * PERIOD, HOME) for cycle in range(3)] == [(0.0,) * 6] * 3


@pytest.mark.parametrize("stamp, offset", [(0, 0.001), (-5, 0.001), (PERIOD, 1.0)])
def test_a_pose_that_was_not_moved_to_is_at_rest(stamp, offset):
    """A stamp that is not newer; a twin that has taken the arm's pose over."""
    velocities = JointVelocities(LARGEST)
    velocities.of(0, HOME)
    q = tuple(value + offset for value in HOME)
    assert velocities.of(stamp, q) == (0.0,) * 6
    # and from there the motion goes on
    later = tuple(value + 0.001 for value in q)
    np.testing.assert_allclose(velocities.of(stamp + PERIOD, later), 0.05)


def test_the_robot_s_largest_speeds_tell_what_a_jump_is():
    velocities = JointVelocities((100.0,) * 6)
    velocities.of(0, HOME)
    np.testing.assert_allclose(velocities.of(PERIOD, tuple(value + 1.0 for value in HOME)), 50.0)


class Sent:
    """Keeps what is published."""

    def __init__(self):
        self.messages: list = []

    def publish(self, message) -> None:
        self.messages.append(message)


def test_the_node_publishes_the_twin_s_pose_with_its_own_stamp():
    robot, sent = kr120(), Sent()
    node = JointVelocitiesNode(robot.joint_names, JointVelocities(LARGEST), 0.02, sent)
    assert not node.known and node.report().level != 0
    first = node.on_twin(5 * NANOSECONDS, HOME)
    second = node.on_twin(5 * NANOSECONDS + PERIOD, tuple(value + 0.01 for value in HOME))
    message = sent.messages[-1]
    assert (message.header.stamp.secs, message.header.stamp.nsecs) == (5, PERIOD)
    assert tuple(message.name) == robot.joint_names
    np.testing.assert_allclose(message.position, np.array(HOME) + 0.01)
    np.testing.assert_allclose(message.velocity, 0.5)
    assert second == pytest.approx(first + 0.02, abs=1e-9) and node.known and node.report().level == 0
