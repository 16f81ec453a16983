"""The mock arm with mass: it answers as the realistic servo, and is pushed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from processes import ROOT

from construction_twin.extensions.physics.mock_servo import PhysicsServo
from construction_twin.mock.faults import Fault, FaultBoard
from construction_twin.mock.program import MockSettings, build_controller, build_servo
from construction_twin.mock.servo import RealisticServo

DRIVES = str(ROOT / "config/kr120_drives.yaml")


def settings(**changes):
    return MockSettings(
        **{"gateway_host": "a", "gateway_port": 9, "servo": "physics", "drives": DRIVES, "payload": [60, 0, 0, 0.2]}
        | changes
    )


@pytest.fixture
def controller(robot):
    return build_controller(settings(), robot)


def rest(servo, pose, cycles=50):
    for _ in range(cycles):
        servo.step(pose)
    return np.array(servo.measured)


@pytest.mark.parametrize("cycle", [4, 12])
def test_it_answers_as_the_realistic_servo(robot, cycle):
    servo = build_servo(settings(cycle=cycle), robot)
    plain = RealisticServo(period=cycle / 1000)
    servo.reset(robot.home)
    plain.reset(robot.home)
    worst = 0.0
    for k in range(300):
        s = 0.3 * (1.0 - math.cos(k * cycle / 1000 * 2.0))
        pose = tuple(q + s for q in robot.home)
        worst = max(worst, np.abs(np.subtract(servo.step(pose), plain.step(pose))).max())
    assert worst < 5e-5


def test_a_stalled_axis_stands_and_comes_back(robot):
    servo = build_servo(settings(), robot)
    servo.reset(robot.home)
    servo.stall(2)
    goal = tuple(q + 0.05 for q in robot.home)
    stood = {servo.step(goal)[2] for _ in range(100)}
    assert len(stood) == 1 and stood.pop() == pytest.approx(robot.home[2], abs=1e-9)
    servo.release(2, 1.0, 2.0)
    rest(servo, goal, 300)
    assert servo.measured == pytest.approx(goal, abs=1e-4)


def test_a_collision_pushes_its_axis_until_it_ends(controller):
    board, servo, home = FaultBoard(controller, 0), controller.servo, controller.config.start_pose
    before = rest(servo, home)
    board.inject(Fault("collision", "A3", (400.0,), duration=0.4))
    assert 1e-5 < rest(servo, home)[2] - before[2] < 1e-2 and board.active == ("collision A3",)
    for _ in range(101):
        board.tick()
    assert board.active == ()
    np.testing.assert_allclose(rest(servo, home), before, atol=1e-6)


class Turned:
    """In place of a plant: notes what it is told, in joints."""

    def __init__(self):
        self.q, self.pushed = np.zeros(2), []

    def place(self, q):
        self.q = np.array(q)

    def cycle(self, setpoint, cycles=1):
        self.q = setpoint

    def push(self, joint, torque):
        self.pushed.append((joint, torque))


def test_an_axis_that_turns_the_other_way_is_pushed_in_its_own_sense():
    plant = Turned()
    servo = PhysicsServo(plant, lambda q: (q[0], 1.0 - q[1]), lambda a: (a[0], 1.0 - a[1]), (1, -1), resolution=0.0)
    servo.reset((0.1, 0.2))
    assert plant.q.tolist() == [0.1, 0.8] and servo.measured == pytest.approx((0.1, 0.2))
    servo.push(1, 3.0)
    assert plant.pushed == [(1, -3.0)]
