"""When a reply arrived, told by the kernel's stamp: a mock that wakes late judges no reply by its own clock."""

from __future__ import annotations

import sys

import pytest
from mock_cell import ZERO, Cell, running
from processes import wait_until

from construction_twin.core.units import NANOSECONDS
from construction_twin.mock.network import steady_offset
from construction_twin.rsi.gateway_codec import RobotDecoder

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


# -- the conversion ----------------------------------------------------------------------------------------------------


def test_a_stamp_is_converted_within_a_microsecond_also_where_a_pause_falls_between_the_readings_of_the_clocks():
    steady, ahead, pauses = [50 * NANOSECONDS], 1_700_000_000 * NANOSECONDS, [3 * MS, 2 * MS]

    def read(pause=0):
        steady[0] += 100 + pause
        return steady[0]

    offset = steady_offset(lambda: read(pauses.pop() if pauses else 0) + ahead, read)
    assert offset == pytest.approx(-ahead, abs=1000)


def test_a_reply_that_arrived_after_its_cycle_does_not_count():
    cell = Cell()
    packet = RobotDecoder(cell.config.axes).parse(cell.mock.begin_cycle())
    assert not cell.mock.receive(cell.encoder.encode(ZERO, packet.controller_ms), in_time=False)
    assert cell.mock.refusals.last == f"the reply to IPOC {packet.controller_ms} came after the end of its cycle"
    assert cell.cycle(ZERO).missed == 1
    assert cell.mock.counters["late_replies"] == 1
