"""Every joint with position and velocity, from poses of the chain; the node around it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scene_samples import kr120

from construction_twin.core.units import NANOSECONDS
from construction_twin.robot.description import load_robot, read_robot_files
from construction_twin.robot.joint_states import JointStates
from construction_twin.ros.nodes.joint_state_publisher import JointStatePublisherNode

DATA = Path(__file__).resolve().parents[2] / "data"
GRIPPER = read_robot_files(DATA / "ur_like_gripper.urdf.xacro", DATA / "ur_like_gripper.yaml")
PERIOD = 20_000_000


def test_velocities_are_those_of_the_motion():
    robot = kr120()
    states = JointStates(robot)
    assert states.names == robot.joint_names
    for cycle in range(100):
        time = cycle * 0.02
        q = tuple(value + 0.1 * (number + 1) * math.sin(time) for number, value in enumerate(robot.home))
        velocities = states.velocities(cycle * PERIOD, q)
        if cycle == 0:
            assert velocities == [0.0] * 6
            continue
        # of the middle between the two poses
        expected = [0.1 * (number + 1) * math.cos(time - 0.01) for number in range(6)]
        np.testing.assert_allclose(velocities, expected, rtol=1e-4)


def test_at_rest_they_are_zero():
    states = JointStates(kr120())
    assert [states.velocities(cycle * PERIOD, kr120().home) for cycle in range(3)] == [[0.0] * 6] * 3


@pytest.mark.parametrize("stamp, offset", [(0, 0.001), (-5, 0.001), (PERIOD, 1.0)])
def test_a_pose_that_was_not_moved_to_is_at_rest(stamp, offset):
    """A stamp that is not newer; a twin that has taken the arm's pose over."""
    states = JointStates(kr120())
    states.velocities(0, kr120().home)
    q = tuple(value + offset for value in kr120().home)
    assert states.velocities(stamp, q) == [0.0] * 6
    # and from there the motion goes on
    later = tuple(value + 0.001 for value in q)
    np.testing.assert_allclose(states.velocities(stamp + PERIOD, later), 0.05)


def test_joints_outside_of_the_chain_stand_where_the_robot_yaml_says():
    states = JointStates(GRIPPER)
    chain = {name: 0.1 * number for number, name in enumerate(GRIPPER.joint_names)}
    shown = dict(zip(states.names, states.positions(tuple(chain.values()))))
    assert shown == pytest.approx(chain | {"slide_left": 0.03, "slide_right": 0.03, "hinge": 0.4})
    states.velocities(0, tuple(chain.values()))
    moved = states.velocities(NANOSECONDS, tuple(value + 0.5 for value in chain.values()))
    assert dict(zip(states.names, moved)) == pytest.approx(
        {name: 0.5 for name in chain} | dict.fromkeys(("slide_left", "slide_right", "hinge"), 0.0)
    )


def test_a_mimic_joint_of_the_chain_moves_with_it():
    follower = (
        '<link name="flag"/><link name="tag"/>'
        '<joint name="flag" type="revolute"><parent link="base_link"/><child link="flag"/><axis xyz="0 0 1"/>'
        '<limit lower="-9" upper="9" velocity="9" effort="1"/><mimic joint="joint_a1" multiplier="-2" offset="0.5"/></joint>'
        '<joint name="tag" type="revolute"><parent link="flag"/><child link="tag"/><axis xyz="0 0 1"/>'
        '<limit lower="-9" upper="9" velocity="9" effort="1"/><mimic joint="flag" multiplier="3"/></joint></robot>'
    )
    robot = kr120()
    settings = {
        "name": robot.name, "base_link": robot.base_link, "tip_link": robot.tip_link,
        "joints": {
            name: {
                "home_deg": math.degrees(home), "acceleration_deg_s2": 100, "jerk_deg_s3": 1000,
                "rsi": axis.rsi, "sign": 1, "offset_deg": 0,
            }
            for name, home, axis in zip(robot.joint_names, robot.home, robot.axes)
        },
    }  # fmt: skip
    states = JointStates(load_robot(robot.urdf.replace("</robot>", follower), settings))
    q = (0.2, *robot.home[1:])
    shown = dict(zip(states.names, states.positions(q)))
    assert (shown["flag"], shown["tag"]) == pytest.approx((0.1, 0.3))
    states.velocities(0, q)
    velocities = dict(zip(states.names, states.velocities(PERIOD, (0.22, *q[1:]))))
    assert (velocities["joint_a1"], velocities["flag"], velocities["tag"]) == pytest.approx((1.0, -2.0, -6.0))


class Sent:
    """Keeps what is published."""

    def __init__(self):
        self.messages: list = []

    def publish(self, message) -> None:
        self.messages.append(message)


def test_the_node_publishes_the_twin_s_pose_with_its_own_stamp():
    """A stamp made anew would call the pose of a twin that is gone a present one."""
    robot, sent = kr120(), Sent()
    node = JointStatePublisherNode(JointStates(robot), robot.home, 0.02, sent)
    assert not node.known and node.report().level != 0
    first = node.on_twin(5 * NANOSECONDS, robot.home)
    second = node.on_twin(5 * NANOSECONDS + PERIOD, tuple(value + 0.01 for value in robot.home))
    message = sent.messages[-1]
    assert (message.header.stamp.secs, message.header.stamp.nsecs) == (5, PERIOD)
    assert tuple(message.name) == robot.joint_names
    np.testing.assert_allclose(message.position, np.array(robot.home) + 0.01)
    np.testing.assert_allclose(message.velocity, 0.5)
    assert second == pytest.approx(first + 0.02, abs=1e-9) and node.known and node.report().level == 0


def test_another_robot_s_largest_speeds_tell_what_a_jump_is():
    fast = replace(kr120(), velocity=(100.0,) * 6)
    states = JointStates(fast)
    states.velocities(0, fast.home)
    np.testing.assert_allclose(states.velocities(PERIOD, tuple(value + 1.0 for value in fast.home)), 50.0)
