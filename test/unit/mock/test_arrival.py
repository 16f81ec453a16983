"""When a reply arrived, told by the kernel's stamp: a mock that wakes late judges no reply by its own clock."""

from __future__ import annotations

import sys
import time

import pytest
from mock_cell import Cell
from mock_pc import ZERO, running
from processes import wait_until

from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.mock import network
from construction_twin.mock.network import ArrivalClock
from construction_twin.rsi.gateway_codec import parse_robot

MS = NANOSECONDS // 1000
STAMPED = pytest.mark.skipif(sys.platform != "linux", reason="only Linux stamps datagrams in the kernel")


def asleep(pc):
    """Return what makes the mock wake up after each late answer has come, and not before."""

    def sleep(mock):
        if mock.counters["packets"] in pc.after:
            ipoc = mock.controller.stamp
            wait_until(lambda: ipoc in pc.answered)

    return sleep


def asked_late(pc):
    """Return the IPOC of the packets whose answers were to be late."""
    return [packet.controller_ms for number, (_, packet, _) in enumerate(list(pc.received), 1) if number in pc.after]


def delays_after(pc, packets):
    """Return what `Delay` says in the packet after each of these."""
    told = {packet.controller_ms: packet.missed for _, packet, _ in list(pc.received)}
    return [told.get(ipoc + 4) for ipoc in packets]


@STAMPED
def test_replies_of_5_and_11_ms_are_late_also_when_the_mock_itself_wakes_later(robot, pc):
    pc.after = {20: 5 * MS, 40: 11 * MS}
    with running(robot, pc.address, observe=asleep(pc), timeout=2500) as mock:
        wait_until(lambda: len(pc.received) >= 60)
        # one each, and more where this machine made others late
        missed = delays_after(pc, asked_late(pc))
        assert len(missed) == 2 and min(missed) >= 1
        assert mock.counters["late_replies"] >= 2 <= mock.counters["missed"]


def test_without_stamps_a_reply_that_is_read_in_the_open_cycle_counts(robot, pc, monkeypatch):
    monkeypatch.setattr(network, "ask_for_stamps", lambda sock: False)
    pc.after = {20: 11 * MS}
    with running(robot, pc.address, observe=asleep(pc), timeout=2500):
        wait_until(lambda: len(pc.received) >= 60)
        assert delays_after(pc, asked_late(pc)) == [0]


@STAMPED
def test_a_reply_that_came_in_time_counts_however_late_it_is_read(robot, pc):
    left: dict[int, int] = {}

    def sleep(mock):
        ipoc = mock.controller.stamp
        if mock.counters["packets"] % 20 == 0:
            left[ipoc] = mock.left
            wait_until(lambda: ipoc in pc.answered and time.monotonic_ns() > mock.left + 3 * CYCLE_NS)

    def in_time():
        """The packets that the PC answered in half a cycle: on a busy machine not every one."""
        return [ipoc for ipoc in left if pc.answered.get(ipoc, ipoc + NANOSECONDS) - left[ipoc] < CYCLE_NS // 2]

    with running(robot, pc.address, observe=sleep, timeout=2500):
        wait_until(lambda: len(in_time()) >= 3 and None not in delays_after(pc, in_time()[:3]))
        assert delays_after(pc, in_time()[:3]) == [0, 0, 0]


# -- the conversion ----------------------------------------------------------------------------------------------------


class Clocks:
    """A wall clock and a monotonic one; reading either takes 100 ns."""

    def __init__(self):
        self.steady, self.ahead = 50 * NANOSECONDS, 1_700_000_000 * NANOSECONDS
        self.pauses = []

    def wall(self):
        if self.pauses:
            self.steady += self.pauses.pop()
        self.steady += 100
        return self.steady + self.ahead

    def monotonic(self):
        self.steady += 100
        return self.steady


@pytest.fixture
def clocks():
    return Clocks()


@pytest.fixture
def arrival(clocks):
    return ArrivalClock(clocks.wall, clocks.monotonic)


def test_a_stamp_is_converted_within_a_microsecond(clocks, arrival):
    came = clocks.steady
    clocks.steady += 11 * MS
    assert arrival.arrival(came + clocks.ahead, clocks.steady) == pytest.approx(came, abs=1000)


def test_a_pause_between_the_readings_of_the_clocks_does_not_count(clocks, arrival):
    came = clocks.steady
    clocks.pauses = [3 * MS, 2 * MS]
    assert arrival.arrival(came + clocks.ahead, clocks.steady + 20 * MS) == pytest.approx(came, abs=1000)


@pytest.mark.parametrize("step", [-NANOSECONDS, 3 * MS, 3600 * NANOSECONDS])
def test_a_wall_clock_that_is_set_judges_nothing_until_it_was_read_again(clocks, arrival, step):
    came = clocks.steady
    stamp = came + clocks.ahead
    clocks.steady += MS
    clocks.ahead += step
    read = clocks.steady
    # set after the datagram came: its stamp is on a clock that is no more
    assert arrival.arrival(stamp, read) is None
    arrival.measure()
    assert arrival.arrival(stamp, read) is None
    arrival.measure()
    came = clocks.steady
    assert arrival.arrival(came + clocks.ahead, came + 5 * MS) == pytest.approx(came, abs=1000)


def test_nothing_arrives_after_it_was_read(clocks, arrival):
    read = clocks.steady
    assert arrival.arrival(read + clocks.ahead + MS, read) == read


def test_a_reply_that_arrived_after_its_cycle_does_not_count():
    cell = Cell()
    packet = parse_robot(cell.mock.begin_cycle(), cell.config.axes)
    assert not cell.mock.receive(cell.encoder.encode(ZERO, packet.controller_ms), in_time=False)
    assert cell.mock.refusals.last == f"the reply to IPOC {packet.controller_ms} came after the end of its cycle"
    assert cell.cycle(ZERO).missed == 1
    assert cell.mock.counters["late_replies"] == 1
