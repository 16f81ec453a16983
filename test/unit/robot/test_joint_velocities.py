"""Velocities as differences of the twin's poses; the node around them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scene_samples import kr120

from construction_twin.core.units import NANOSECONDS
from construction_twin.ros.nodes.joint_velocities import JointVelocities, JointVelocitiesNode, ShownStream

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

    @property
    def is_heard(self) -> bool:
        return True

    def publish(self, *message) -> None:
        self.messages.append(message[0] if len(message) == 1 else message)


@dataclass
class Bench:
    """A node, and what it publishes."""

    node: JointVelocitiesNode
    messages: list

    @property
    def last(self):
        return self.messages[-1]


def bench(period: float = 0.02) -> Bench:
    sent = Sent()
    shown = ShownStream(0.04, Sent())
    return Bench(JointVelocitiesNode(kr120().joint_names, JointVelocities(LARGEST), period, sent, shown), sent.messages)


def moving(found: Bench, now: float) -> None:
    """Publish two poses, the second at `now`."""
    found.node.on_twin(now - 0.02, 5 * NANOSECONDS, HOME)
    found.node.on_twin(now, 5 * NANOSECONDS + PERIOD, tuple(value + 0.01 for value in HOME))


def test_the_node_publishes_the_twin_s_pose_with_its_own_stamp():
    found = bench()
    assert found.node.report().sentence == "the twin has no pose yet" and found.node.report().level != 0
    first = found.node.on_twin(7.0, 5 * NANOSECONDS, HOME)
    second = found.node.on_twin(7.001, 5 * NANOSECONDS + PERIOD, tuple(value + 0.01 for value in HOME))
    assert (found.last.header.stamp.secs, found.last.header.stamp.nsecs) == (5, PERIOD)
    assert tuple(found.last.name) == kr120().joint_names
    np.testing.assert_allclose(found.last.position, np.array(HOME) + 0.01)
    np.testing.assert_allclose(found.last.velocity, 0.5)
    assert (first, second) == (7.0, pytest.approx(7.02)) and found.node.report().level == 0


@pytest.mark.parametrize("period, silence", [(0.02, 0.25), (1.0, 2.0)])
def test_a_twin_that_falls_silent_in_mid_motion_is_shown_at_rest_once(period, silence):
    found = bench(period)
    moving(found, 10.0)
    assert found.node.watch(10.1) == pytest.approx(silence - 0.1)
    assert len(found.messages) == 2, "not silent yet"
    assert found.node.watch(10.0 + silence) == silence
    assert tuple(found.last.velocity) == (0.0,) * 6
    assert (found.last.position, found.last.header.stamp) == (
        found.messages[1].position,
        found.messages[1].header.stamp,
    )
    for later in range(1, 5):
        assert found.node.watch(10.0 + silence + later) == silence
    assert len(found.messages) == 3, "once"
    assert "silent" in found.node.report().sentence and found.node.report().level != 0


def test_a_twin_that_was_silent_is_watched_again_once_it_is_back():
    found = bench()
    assert found.node.watch(0.0) == 0.25 and not found.messages, "it never had a pose"
    moving(found, 10.0)
    found.node.watch(10.3)
    found.node.on_twin(11.0, 6 * NANOSECONDS, HOME)
    found.node.on_twin(11.02, 6 * NANOSECONDS + PERIOD, tuple(value + 0.01 for value in HOME))
    np.testing.assert_allclose(found.last.velocity, 0.5)
    assert found.node.report().level == 0 and len(found.messages) == 5
    found.node.watch(11.3)
    assert tuple(found.last.velocity) == (0.0,) * 6 and len(found.messages) == 6


def test_what_tf_is_made_of_is_passed_on_as_it_came():
    sent = Sent()
    stream = ShownStream(0.04, sent)
    assert stream.take(7.0, ("a",), (1.0,), "message") == 7.04
    assert stream.take(7.04, ("a",), (1.0,), "the same again") == pytest.approx(7.08)
    assert stream.take(7.3, ("a",), (1.0,), 5, (1.0,)) == pytest.approx(7.34)
    assert sent.messages == ["message", (5, (1.0,))]
