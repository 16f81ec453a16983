"""Faults of the mock controller, cycle by cycle on a simulated clock."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mock_cell import CONFIG, HOME, ZERO, Cell, step

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import CYCLE, radians
from construction_twin.mock.faults import KINDS, Fault, FaultBoard
from construction_twin.mock.own_motion import Program

FAR = radians((20, -80, 80, 10, 80, -20))


class Bench(Cell):
    """A cell with faults; `ramp` moves A1 at a constant speed."""

    def __init__(self, **changes):
        super().__init__(**changes)
        self.faults = FaultBoard(self.mock, 7)
        self.angle = 0.0

    def cycle(self, *arguments, **options):
        self.faults.tick()
        return super().cycle(*arguments, **options)

    def ramp(self, count, speed=20.0):
        """Move A1 at `speed` [deg/s]; return what the packets report of it [rad]."""
        reported = []
        for _ in range(count):
            self.angle += speed * CYCLE
            reported.append(self.cycle(step(0, self.angle)).measured[0])
        return np.array(reported)


def limits_kept(positions, limits=CONFIG):
    """Check positions, shape (k, n) [rad], from rest, against the limits of the first n axes."""
    steps = np.diff(positions, axis=0, prepend=positions[:1])
    count = steps.shape[1]
    assert (np.abs(steps) <= np.array(limits.velocity[:count]) * CYCLE * (1 + 1e-9)).all()
    changes = np.diff(steps, axis=0, prepend=0 * steps[:1])
    assert (np.abs(changes) <= np.array(limits.acceleration[:count]) * CYCLE**2 * (1 + 1e-6)).all()


@pytest.mark.parametrize(
    "fault",
    [
        Fault("melt"),
        Fault("stall"),
        Fault("stall", "A9"),
        Fault("stall", "A1", (1.0,)),
        Fault("slow", "A1", (0.0,)),
        Fault("offset", "A1", (math.nan,)),
        Fault("offset", "A1", (0.1,), "to_pc"),
        Fault("drop", values=(1.5,)),
        Fault("drop", "A1", (0.5,)),
        Fault("delay", values=(0.001,), direction="sideways"),
        Fault("restart_at", values=(0.0,)),
        Fault("restart_at", values=radians((0, 0, 90, 0, 90, 0))),
        Fault("jog", values=FAR, duration=0.1),
        Fault("noise", values=(1e-4,), duration=-1.0),
    ],
    ids=str,
)
def test_what_makes_no_sense_is_refused_and_changes_nothing(fault):
    bench = Bench()
    with pytest.raises(ConfigurationError, match=fault.name if fault.name in KINDS else "melt"):
        bench.faults.inject(fault)
    assert (bench.faults.active, bench.faults.changes) == ((), 0)


def test_a_fault_ends_by_itself_after_its_duration():
    bench = Bench()
    bench.cycle(ZERO)
    bench.faults.inject(Fault("offset", "A2", (0.01,), duration=0.1))
    off = [bench.cycle(ZERO).measured[1] - HOME[1] > 0.005 for _ in range(40)]
    assert off == [True] * 24 + [False] * 16
    assert bench.faults.active == () and bench.faults.changes == 2


def test_a_slow_joint_brakes_to_its_speed_trails_and_catches_up_within_limits():
    bench = Bench()
    speed = 20.0
    reported = []
    for k in range(1400):
        # accelerates at 100 deg/s^2, runs, brakes
        bench.angle += CYCLE * min(speed, 100 * CYCLE * k, max(0.0, 100 * CYCLE * (800 - k)))
        if k == 200:
            bench.faults.inject(Fault("slow", "A1", (math.radians(8.0),)))
        if k == 900:
            bench.faults.end(Fault("slow", "A1"))
        bench.cycle(step(0, bench.angle))
        reported.append(bench.mock.reported[:1])
    positions = np.array(reported)
    limits_kept(positions)
    velocity = np.degrees(np.diff(positions[:, 0])) / CYCLE
    np.testing.assert_allclose(velocity[260:800], 8.0, atol=1e-5)
    assert velocity.max() <= 123.0
    assert positions[-1, 0] == pytest.approx(math.radians(bench.angle), abs=1e-8)


def test_offset_and_drift_move_the_reading_and_not_the_arm():
    bench = Bench()
    bench.cycles(5)
    bench.faults.inject(Fault("offset", "A1", (0.02,)))
    bench.faults.inject(Fault("drift", "A2", (-0.1,)))
    packets = bench.cycles(51)
    assert packets[0].measured[0] == pytest.approx(0.02, abs=1e-7)
    assert packets[50].measured[1] - packets[0].measured[1] == pytest.approx(-0.1 * 50 * CYCLE, abs=1e-7)
    assert bench.mock.true_position == HOME
    bench.faults.end(Fault("offset", "A1"))
    assert bench.cycle(ZERO).measured[0] == 0.0


def test_a_restarted_controller_takes_its_readings_for_its_pose():
    bench = Bench()
    bench.cycles(5)
    bench.faults.inject(Fault("offset", "A1", (0.02,)))
    bench.cycles(5)
    bench.mock.restart()
    packet = bench.cycle(ZERO)
    assert packet.measured[0] == packet.setpoint[0] == pytest.approx(0.02, abs=1e-7)
    assert bench.mock.true_position == pytest.approx(HOME)


def test_backlash_holds_the_reading_back_by_half_the_play():
    bench = Bench()
    bench.cycles(5)
    bench.faults.inject(Fault("backlash", "A1", (math.radians(0.4),)))
    there = np.degrees(bench.ramp(200, 5.0))
    back = np.degrees(bench.ramp(200, -5.0))
    assert there[-1] == pytest.approx(4.0 - 3 * 0.02 - 0.2, abs=1e-5)
    # the play is crossed before it comes back: 0.4 deg at 5 deg/s are 20 cycles
    assert np.ptp(back[2:20]) == pytest.approx(0.0, abs=1e-6)
    assert back[-1] - np.degrees(bench.mock.measured[0]) == pytest.approx(0.2, abs=1e-5)


def test_an_emergency_stop_brakes_all_axes_together_within_their_limits():
    bench = Bench()
    slope = np.array((20.0, 15.0, 5.0, 0.0, 40.0, -30.0))
    positions, angle = [], np.zeros(6)
    for k in range(100):
        angle += slope * CYCLE * min(1.0, k / 50)
        bench.cycle(radians(angle))
        positions.append(bench.mock.setpoint)
    bench.faults.inject(Fault("estop"))
    ramp = bench.mock.ramp
    before = np.array(bench.mock.measured)
    assert (np.abs(np.array(bench.mock.setpoint) - before)[slope != 0.0] > 1e-4).all(), "the arm trails its setpoint"
    for _ in range(200):
        assert bench.cycle(ZERO) is None
        positions.append(bench.mock.setpoint)
    limits_kept(np.array(positions))
    assert bench.mock.reason == "emergency stop"
    # the arm's way, not the setpoint's
    np.testing.assert_allclose(np.array(bench.mock.measured) - before, ramp.distance, atol=1e-12)
    # A1 needs longest: 20 deg/s at 155.8 deg/s^2
    assert ramp.cycles == math.ceil(20.0 / 155.8 / CYCLE)
    assert bench.mock.measured == bench.mock.setpoint
    with pytest.raises(ConfigurationError, match="restart.*a released one: inject `estop` with `on` false"):
        bench.mock.restart()
    bench.faults.end(Fault("estop"))
    bench.mock.restart()
    assert bench.cycle(ZERO).measured == pytest.approx(positions[-1], abs=1e-7)


def test_replies_are_ignored_until_rsi_has_timed_out():
    bench = Bench(timeout=10)
    bench.cycles(5)
    bench.faults.inject(Fault("rsi_timeout"))
    assert [bench.cycle(ZERO) is None for _ in range(12)] == [False] * 10 + [True] * 2
    assert bench.mock.reason.startswith("timeout") and bench.mock.counters["ignored"] == 10
    assert bench.faults.active == ()
    bench.mock.restart()
    assert all(bench.cycles(30))


@pytest.mark.parametrize("running", [True, False])
def test_a_program_of_its_own_ends_at_its_pose_within_limits(running):
    bench = Bench()
    for k in range(51):
        bench.cycle(step(0, 0.02 * k))
    bench.cycles(5, step(0, 1.0))
    if not running:
        bench.faults.inject(Fault("estop"))
        bench.cycles(20)
        bench.faults.end(Fault("estop"))
    bench.faults.inject(Fault("jog", values=FAR))
    positions = []
    for _ in range(1000):
        packet = bench.cycle(step(0, 1.0))
        assert (packet is not None) == running
        positions.append(bench.mock.setpoint)
    limits_kept(np.array(positions))
    assert bench.mock.measured == pytest.approx(FAR, abs=1e-9)
    assert bench.mock.program is None
    if running:
        assert packet.setpoint[0] == pytest.approx(FAR[0] - math.radians(1.0), abs=1e-7)


@settings(max_examples=60)
@given(goal=st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6), duration=st.floats(0.0, 5.0))
def test_a_program_stays_within_limits_or_says_how_long_it_needs(goal, duration):
    start = np.zeros(6)
    try:
        program = Program(start, goal, CONFIG.velocity, CONFIG.acceleration, duration)
    except ConfigurationError as error:
        quickest = float(re.search(r"([0-9.]+) s", error.expected)[1])
        assert quickest >= round(duration, 3) and duration == error.value
        return
    positions = np.array([start] + [program.advance() for _ in range(program.cycles + 2)])
    limits_kept(positions)
    assert tuple(positions[-1]) == tuple(goal)


def test_a_seed_loses_the_same_datagrams_in_every_process():
    # in a process of its own too: the hash of a text, which differs there, is no seed
    faults = Bench().faults
    arrived = []
    for line in (faults.to_pc, faults.to_controller):
        line.drop = 0.5
        for number in range(16):
            line.send(bytes([number]), 0)
        arrived.append([datagram.data[0] for datagram in line.pop_arrived(0)])
    assert arrived == [[2, 3, 6, 9, 12, 14], [3, 4, 6, 7, 8, 12]]
