"""The mock at 12 ms (KR C2, or `#IPO` on a KR C4): supervision, servo, own motions and faults count in seconds, as at 4 ms."""

from __future__ import annotations

import numpy as np
import pytest
from mock_cell import CONFIG, HOME, ZERO, Cell, assert_stopped, step
from mock_pc import Pc, running
from processes import ROOT, wait_until

from construction_twin.core.units import radians
from construction_twin.mock.faults import Fault, FaultBoard
from construction_twin.mock.servo import IdealServo, RealisticServo
from construction_twin.robot.description import read_robot_files

#: Both cycles [ms]: what holds for one must hold for the other.
BOTH = pytest.mark.parametrize("cycle", [4, 12])


def cell(cycle, servo=None, **changes):
    return Cell(servo or IdealServo(3, cycle / 1000), cycle=cycle, **changes)


def seconds(cycle, duration):
    """Return how many cycles this is."""
    return round(duration * 1000 / cycle)


def test_a_reply_one_cycle_late_is_12_behind_and_4_behind_is_none():
    slow = cell(12)
    slow.cycles(5)
    packet = slow.cycle(ZERO, ipoc_offset=-12)
    assert slow.mock.refusals.last == f"the reply to IPOC {packet.controller_ms - 12} came 1 cycle late"
    slow.cycle(ZERO, ipoc_offset=-4)
    assert (slow.mock.counters["late_replies"], slow.mock.counters["mismatched"]) == (1, 1)


def test_velocity_is_judged_per_second_not_per_cycle():
    slow = cell(12)
    slow.cycle(step(0, 1.0))
    assert slow.cycle(step(0, 1.0)) is not None
    quick = cell(12)
    quick.cycle(step(0, 3.0))
    assert_stopped(quick, "command velocity A1: 250 deg/s, limit 246 deg/s (2 times 123 deg/s)")


@BOTH
def test_a_motion_of_the_controller_lasts_as_long_and_keeps_the_limits(cycle):
    moved = cell(cycle, IdealServo(1, cycle / 1000))
    goal = tuple(q + delta for q, delta in zip(HOME, radians((30, 10, -20, 40, 5, 60))))
    moved.mock.run_program(goal, 4.0)
    positions = [HOME]
    while moved.mock.program is not None:
        moved.cycle(ZERO)
        positions.append(moved.mock.setpoint)
    assert len(positions) == pytest.approx(seconds(cycle, 4.0), abs=3)
    moved.cycles(3)
    assert moved.mock.measured == pytest.approx(goal)
    limits_kept(positions, cycle)


def limits_kept(positions, cycle):
    """Assert velocity and acceleration of a row of setpoints [rad]."""
    period, path = cycle / 1000, np.array([positions[0], *positions])
    speeds = np.diff(path, axis=0) / period
    assert (np.abs(speeds) <= np.array(CONFIG.velocity) * (1 + 1e-9)).all()
    assert (np.abs(np.diff(speeds, axis=0)) / period <= np.array(CONFIG.acceleration) * (1 + 1e-6)).all()


def at_speed(cycle, speed, **changes):
    """Return a cell whose A1 moves at `speed` [rad/s]."""
    moving = cell(cycle, IdealServo(1, cycle / 1000), **changes)
    position = 0.0
    for k in range(seconds(cycle, 2.4)):
        position += min(1.0, k * cycle / 1200) * speed * cycle / 1000
        assert moving.cycle((position, 0, 0, 0, 0, 0)) is not None
    return moving


@BOTH
def test_an_emergency_stop_brakes_in_the_time_that_the_limit_asks_for(cycle):
    moving = at_speed(cycle, 0.5)
    moving.mock.press_emergency_stop()
    wanted = 0.5 / CONFIG.acceleration[0]
    assert moving.mock.ramp.cycles * cycle / 1000 == pytest.approx(wanted, abs=cycle / 1000)
    positions = [moving.mock.setpoint]
    for _ in range(moving.mock.ramp.cycles + 2):
        moving.cycle()
        positions.append(moving.mock.setpoint)
    assert moving.mock.ramp.done and positions[-1] == positions[-2]
    assert positions[-1][0] - positions[0][0] == pytest.approx(0.5 * wanted / 2, rel=0.15)


@BOTH
def test_t1_limits_the_tool_per_second(cycle):
    moving = cell(cycle, IdealServo(1, cycle / 1000), acceleration_factor=0.0)
    moving.mock.limit_tool_speed(0.25)
    positions = []
    for k in range(seconds(cycle, 2.0)):
        moving.cycle((0.0008 * k * cycle, 0, 0, 0, 0, 0))
        positions.append(moving.mock.setpoint)
    # the stand-in kinematics: the tool is where the first three axes say
    fastest = np.linalg.norm(np.diff(np.array(positions)[:, :3], axis=0), axis=1).max() / (cycle / 1000)
    assert fastest == pytest.approx(0.25, rel=1e-6)


@BOTH
def test_a_stalled_joint_catches_up_within_the_limits(cycle):
    moving = cell(cycle)
    faults = FaultBoard(moving.mock, 0)
    faults.inject(Fault("stall", "A1"))
    for k in range(seconds(cycle, 0.8)):
        moving.cycle(step(0, 5.0 * k * cycle / 1000))
    faults.end(Fault("stall", "A1"))
    end = step(0, 5.0 * (seconds(cycle, 0.8) - 1) * cycle / 1000)
    reached = [moving.mock.measured]
    for _ in range(seconds(cycle, 1.2)):
        moving.cycle(end)
        reached.append(moving.mock.measured)
    assert reached[-1][0] == pytest.approx(end[0], abs=1e-9)
    limits_kept(reached, cycle)


@BOTH
def test_the_realistic_servo_lags_by_the_same_time(cycle):
    servo = RealisticServo(resolution=0.0, period=cycle / 1000)
    servo.reset((0.0,))
    for k in range(seconds(cycle, 2.4)):
        servo.step((0.3 * k * cycle / 1000,))
    behind = 0.3 * (seconds(cycle, 2.4) - 1) * cycle / 1000 - servo.measured[0]
    # 2 zeta / omega, and half of the cycle for which a setpoint is held, before which the cycle has passed
    assert behind / 0.3 == pytest.approx(2 * 0.8 / 60.0 - cycle / 2000, abs=1e-4)


# -- with sockets ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot():
    return read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")


def test_packets_leave_every_12_ms_on_an_absolute_grid(robot):
    pc = Pc()
    pc.start()
    try:
        with running(robot, pc.address, cycle=12) as mock:
            wait_until(lambda: len(pc.received) >= 101)
            counters = mock.counters
    finally:
        pc.close()
    times = [entry[0] for entry in pc.received[:101]]
    ipocs = [entry[1].controller_ms for entry in pc.received[:101]]
    assert {b - a for a, b in zip(ipocs, ipocs[1:])} == {12} and counters["skipped"] == 0
    # a busy machine makes packets late, which must not move the grid
    late = [time - k * 12_000_000 for k, time in enumerate(times)]
    assert min(late[50:]) - min(late[:50]) == pytest.approx(0.0, abs=6_000_000)
