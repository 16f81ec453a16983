"""What time does to the gate: setpoints that waited in a queue, and clocks that are set."""

from __future__ import annotations

import math

import pytest
from gate_bench import CODEC, SETTINGS, START, Bench, moved, states

from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.monitor.comparison import MAX_SETPOINTS, RoundTrips
from construction_twin.monitor.settings import GateSettings
from construction_twin.monitor.states import SyncEvent, SyncState


def bench(**settings) -> Bench:
    """Return an open bench with these settings."""
    opened = Bench(GateSettings(**settings)).opened()
    opened.gate.pop_transitions()
    return opened


class TestLateSetpoints:
    LATE = round(0.11 * NANOSECONDS)

    def burst(self, cell: Bench, cycles: int, spare: int) -> list:
        """Setpoints of the last cycles, all received at one moment, with fresh feedback; the first is that much too late."""
        step, now = cell.stamp, cell.stamp + cycles * CYCLE_NS + spare
        cell.gate.on_twin(now, cell.twin)
        cell.gate.on_physical(cell.twin, 0, now)
        passed = []
        for k in range(1, cycles + 1):
            passed.append(cell.gate.pass_next(step + k * CYCLE_NS, moved(START, 1e-5 * k), now))
        cell.stamp = now
        return passed

    def test_a_burst_of_old_setpoints_does_not_pass_at_once(self):
        cell = bench()
        assert set(self.burst(cell, 125, 0)) == {START}
        change, *more = cell.gate.pop_transitions()
        assert (change.event, change.target, more) == (SyncEvent.SETPOINT_STALE, SyncState.STALE, [])
        assert change.reason.values["late"] == pytest.approx(0.496, abs=1e-3)

    def test_nor_does_what_a_full_queue_has_left_of_them(self):
        cell = bench()
        now = cell.stamp + NANOSECONDS
        cell.gate.on_twin(now, cell.twin)
        cell.gate.on_physical(cell.twin, 0, now)
        left = [cell.gate.pass_next(now - k * CYCLE_NS, moved(START, 1e-3), now) for k in range(24, -1, -1)]
        assert set(left) == {START} and states(cell.gate) == [("setpoint_stale", "STALE")]
        assert cell.gate.reason.values["gap"] == pytest.approx(0.904, abs=1e-3)

    def test_an_executor_that_paused_at_rest_goes_on(self):
        cell = bench()
        assert cell.cycle(cycles=250) == START and cell.cycle(moved(START, 1e-5)) == CODEC.quantise(moved(START, 1e-5))
        assert cell.state is SyncState.IN_SYNC

    def test_what_an_executor_catches_up_with_passes(self):
        cell = bench()
        passed = self.burst(cell, 20, CYCLE_NS)
        assert passed == [CODEC.quantise(moved(START, 1e-5 * k)) for k in range(1, 21)]

    def test_opens_again_only_for_setpoints_of_the_present(self):
        cell = bench()
        self.burst(cell, 125, 0)
        cell.stamp += self.LATE
        for _ in range(50):
            cell.stamp += CYCLE_NS
            cell.gate.on_physical(START, 0, cell.stamp)
            assert cell.gate.pass_next(cell.stamp - self.LATE, START, cell.stamp) == START
        assert cell.state is SyncState.STALE and "; not opened: theta_next is late" in cell.gate.reason
        cell.opened()

    def test_a_new_session_learns_anew_what_is_quick(self):
        cell = bench()
        cell.gate.restart("new command session", cell.stamp)
        for _ in range(50):
            cell.stamp += CYCLE_NS
            cell.gate.on_twin(cell.stamp, START)
            cell.gate.on_physical(START, 0, cell.stamp)
            cell.gate.pass_next(cell.stamp - self.LATE, START, cell.stamp)
        assert cell.state is SyncState.IN_SYNC

    def test_is_not_counted_as_a_violation_of_the_pose(self):
        cell = bench(escalate_count=1)
        self.burst(cell, 125, 0)
        assert cell.state is SyncState.STALE


class TestClocks:
    def test_a_clock_of_the_stamps_that_is_set_back_puts_nothing_off(self):
        cell = bench(give_up_time=0.5)
        gate, now, last = cell.gate, cell.stamp, cell.stamp
        # the stamps' clock goes back by 10 s: the next pose, and the setpoints of an executor on its own grid
        gate.on_physical(START, last - CYCLE_NS, now, last - 10 * NANOSECONDS)
        assert gate.comparison.last.at == last - 10 * NANOSECONDS
        gate.watch(now + round(SETTINGS.feedback_timeout * NANOSECONDS))
        assert gate.state is SyncState.IN_SYNC
        gate.watch(now + round(SETTINGS.feedback_timeout * NANOSECONDS) + 1)
        assert gate.state is SyncState.STALE and not gate.is_agreed(now + NANOSECONDS)
        gate.watch(now + NANOSECONDS)
        assert gate.state is SyncState.STOPPED

    @pytest.mark.parametrize("step", [-10.0, -0.03, 10.0])
    @pytest.mark.parametrize("between", [0, CYCLE_NS // 3])
    def test_the_round_trip_is_measured_on_one_clock(self, step, between):
        cell = bench()
        for _ in range(20):
            cell.cycle()
        at = cell.stamp
        for _ in range(8):
            cell.cycle()
        gate = cell.gate
        set_clock = cell.stamp + round(step * NANOSECONDS)
        comparison = gate.on_physical(START, at - CYCLE_NS + between, cell.stamp, set_clock)
        assert comparison.round_trip == pytest.approx(9 * CYCLE - between / NANOSECONDS) and comparison.at == set_clock

    def test_of_a_setpoint_that_nobody_has_seen_pass_no_round_trip_is_known(self):
        trips = RoundTrips()
        trips.on_setpoint(5 * CYCLE_NS, 100)
        assert trips.elapsed_since(5 * CYCLE_NS, 100 + CYCLE_NS) == CYCLE
        assert trips.elapsed_since(5 * CYCLE_NS, 90) == 0.0
        for unknown in (0, 4 * CYCLE_NS, 6 * CYCLE_NS, (5 + MAX_SETPOINTS) * CYCLE_NS):
            assert math.isnan(trips.elapsed_since(unknown, 100 + CYCLE_NS))
        trips.on_setpoint((5 + MAX_SETPOINTS) * CYCLE_NS, 200)
        assert math.isnan(trips.elapsed_since(5 * CYCLE_NS, 300))

    def test_agreement_takes_its_time_whatever_the_stamps_say(self):
        cell = Bench(GateSettings())
        cell.gate.on_twin(cell.stamp, START)
        for k in range(1, 50):
            now = cell.stamp + k * CYCLE_NS
            cell.gate.on_physical(START, 0, now, cell.stamp + k * NANOSECONDS)
            assert cell.gate.is_agreed(now) is ((k - 1) * CYCLE_NS >= SETTINGS.agree_time * NANOSECONDS)
