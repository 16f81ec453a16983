"""The grid of 4 ms: steady whatever happens to the wall clock, and never back."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import pytest
import rospy

from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.ros.transport import joint_stream as module


class Clocks:
    """A wall clock that can be set, a monotonic one that cannot, and sleep."""

    def __init__(self, monkeypatch):
        self.wall, self.steady = 1000 * NANOSECONDS, 50 * NANOSECONDS
        clock = SimpleNamespace(
            monotonic_ns=lambda: self.steady, sleep=lambda s: self.pass_time(round(s * NANOSECONDS))
        )
        monkeypatch.setattr(module, "now_ns", lambda: self.wall)
        monkeypatch.setattr(module, "time", clock)
        monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
        self.cycles = module.Cycles()
        self.grid = iter(self.cycles)

    def pass_time(self, ns: int) -> None:
        """Let both run."""
        self.wall, self.steady = self.wall + ns, self.steady + ns

    def take(self, number: int) -> list[int]:
        """Return the next stamps."""
        return [stamp for stamp, _ in itertools.islice(self.grid, number)]


@pytest.fixture
def clocks(monkeypatch):
    return Clocks(monkeypatch)


@pytest.mark.parametrize("step", [-10, 10])
def test_a_wall_clock_that_is_set_does_not_disturb_it(clocks, step):
    before, began = clocks.take(5)[-1], clocks.steady
    clocks.wall += step * NANOSECONDS
    assert clocks.take(50) == [before + k * CYCLE_NS for k in range(1, 51)]
    assert clocks.steady - began == 50 * CYCLE_NS


def test_after_a_stall_it_goes_on_at_once_although_the_wall_clock_was_set_back(clocks):
    before = clocks.take(5)[-1]
    clocks.wall -= 10 * NANOSECONDS
    clocks.pass_time(NANOSECONDS)
    began = clocks.steady
    stamp, stalled = next(clocks.grid)
    assert stalled == NANOSECONDS - CYCLE_NS and stamp == before + NANOSECONDS
    clocks.take(10)
    assert clocks.steady - began == 10 * CYCLE_NS


def test_what_is_late_by_less_is_sent_one_after_the_other(clocks):
    before = clocks.take(5)[-1]
    clocks.pass_time(module.CATCH_UP)
    began = clocks.steady
    assert clocks.take(20) == [before + k * CYCLE_NS for k in range(1, 21)] and clocks.steady == began


def test_cycles_that_nobody_wanted_are_left_out_and_are_no_stall(clocks):
    before = clocks.take(5)[-1]
    clocks.pass_time(NANOSECONDS)
    clocks.wall += 10 * NANOSECONDS
    clocks.cycles.skip()
    assert next(clocks.grid) == (before + NANOSECONDS + CYCLE_NS, 0)
    # never twice the same
    clocks.cycles.skip()
    assert clocks.take(2) == [before + NANOSECONDS + k * CYCLE_NS for k in (2, 3)]


def test_its_time_is_its_own(clocks):
    began = clocks.cycles.now()
    assert began == clocks.wall
    clocks.wall += 10 * NANOSECONDS
    clocks.pass_time(NANOSECONDS)
    assert clocks.cycles.now() == began + NANOSECONDS


def test_it_goes_on_from_an_earlier_stamp_when_it_is_told_to(clocks):
    before = clocks.take(5)[-1]
    clocks.cycles.begin_at(before - 10 * NANOSECONDS + 1)
    began = clocks.steady
    assert clocks.take(3) == [before - 10 * NANOSECONDS + k * CYCLE_NS for k in (1, 2, 3)]
    assert clocks.steady - began == 3 * CYCLE_NS - 1
