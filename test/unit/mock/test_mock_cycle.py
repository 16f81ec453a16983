"""The mock at 12 ms (KR C2, or `#IPO` on a KR C4): supervision, servo, own motions and faults count in seconds, as at 4 ms."""

from __future__ import annotations

import numpy as np
import pytest
from mock_cell import CONFIG, ZERO, Cell, step

from construction_twin.mock.faults import Fault, FaultBoard
from construction_twin.mock.servo import IdealServo

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
