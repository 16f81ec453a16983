"""The mock controller's core: acceptance checks (a) to (j) of docs/rsi.md, section 13, on a simulated clock."""

from __future__ import annotations

import math

import pytest
from mock_cell import (
    AXES,
    HOME,
    WITH_STOP,
    ZERO,
    Cell,
    assert_stopped,
    step,
)

from construction_twin.core.units import radians
from construction_twin.robot.motion_errors import JointRangeError
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder


def test_a_ten_seconds_are_2500_packets_and_10000_on_the_ipoc():
    cell = Cell()
    packets = cell.cycles(2500) + [cell.cycle(ZERO)]
    assert cell.mock.counters["packets"] == 2501
    assert packets[0].controller_ms == 4_208_163_634
    assert packets[-1].controller_ms - packets[0].controller_ms == 10_000
    assert {b.controller_ms - a.controller_ms for a, b in zip(packets, packets[1:])} == {4}
    assert cell.mock.counters["missed"] == 0


def test_b_a_reply_to_the_previous_packet_is_not_applied():
    cell = Cell()
    cell.cycles(5)
    cell.cycle(step(0, 0.01), ipoc_offset=-4)
    assert cell.cycle(ZERO).missed == 1
    assert cell.mock.applied == ZERO
    assert cell.mock.counters["late_replies"] == 1
    assert cell.cycle(ZERO).missed == 0


@pytest.mark.parametrize("offset", [4, -2, -40, 1000])
def test_replies_to_no_packet_of_the_session_are_mismatched(offset):
    cell = Cell()
    cell.cycles(5)
    cell.cycle(ZERO, ipoc_offset=offset)
    assert cell.cycle(ZERO).missed == 1
    assert cell.mock.counters["mismatched"] == 1


def test_the_first_of_two_replies_counts():
    cell = Cell()
    packet = cell.cycle(step(0, 0.01))
    assert not cell.mock.receive(cell.encoder.encode(step(0, 0.02), packet.controller_ms))
    cell.cycle(ZERO)
    assert cell.mock.applied == pytest.approx(step(0, 0.01))
    assert cell.mock.counters["duplicates"] == 1


def test_c_silence_of_100_cycles_stops_rsi_at_400_ms():
    cell = Cell()
    cell.cycles(10)
    silent = cell.cycles(100, None)
    assert [packet.missed for packet in silent] == list(range(100))
    assert_stopped(cell, "timeout: 100 cycles")
    assert cell.mock.flag
    assert cell.mock.counters["packets"] == 110
    assert cell.cycles(50) == [None] * 50
    assert not cell.mock.receive(cell.encoder.encode(ZERO, cell.mock.stamp))
    assert cell.mock.counters["unexpected"] == 1


def test_d_a_step_of_one_degree_in_one_cycle_is_a_fault():
    cell = Cell()
    cell.cycles(5)
    cell.cycle(step(0, 1.0))
    assert_stopped(cell, "command velocity A1: 250 deg/s, limit 246 deg/s (2 times 123 deg/s)")
    assert not cell.mock.flag
    assert cell.mock.measured == HOME


def test_e_a_correction_beyond_its_limit_is_clamped_without_an_error():
    upper = step(0, 0.1)[:1] + radians((5,) * 5)
    cell = Cell(correction_upper=upper)
    for k in range(1, 31):
        cell.cycle(step(0, 0.01 * k))
    cell.cycles(5, step(0, 0.3))
    assert cell.mock.running
    assert cell.mock.applied == pytest.approx(step(0, 0.1))
    assert cell.mock.counters["clamped"] == 20 + 5 - 1
    assert cell.packets[-1].measured[0] == pytest.approx(math.radians(0.1))


def test_g_stop_ends_the_session():
    cell = Cell(layout=WITH_STOP)
    cell.cycles(5)
    packet = RobotDecoder(AXES).parse(cell.mock.begin_cycle())
    cell.mock.receive(cell.encoder.encode(ZERO, packet.controller_ms, stop=True))
    assert_stopped(cell, "stop: requested")
    assert not cell.mock.flag


def test_h_setpoint_stays_at_the_start_while_measured_follows():
    cell = Cell()
    corrections = [step(5, 0.05 * k) for k in range(100)]
    packets = [cell.cycle(correction) for correction in corrections]
    assert {packet.setpoint for packet in packets} == {HOME}
    # AIPos of packet k + 3 is start + AK of reply k, exactly as the six decimals of the wire can say it
    for reply, packet in zip(corrections, packets[3:]):
        assert packet.measured == pytest.approx([q + c for q, c in zip(HOME, reply)], abs=math.radians(1e-6))
    assert all(packet.measured == HOME for packet in packets[:3])


def test_i_a_new_session_starts_at_another_pose_with_another_ipoc():
    cell = Cell()
    cell.cycles(50, step(0, 0.2))
    last = cell.packets[-1].controller_ms
    pose = radians((10, -80, 70, 5, 60, -20))
    cell.mock.restart(pose)
    packets = cell.cycles(10)
    assert packets[0].controller_ms > last + 400
    assert packets[0].missed == 0
    assert {packet.setpoint for packet in packets} == {packets[0].setpoint}
    assert packets[-1].measured == packets[0].measured == pytest.approx(pose, abs=1e-9)
    assert (cell.mock.session, cell.mock.applied, cell.mock.running) == (2, ZERO, True)


def test_i_a_stopped_controller_restarts_where_the_arm_stands():
    cell = Cell()
    for k in range(50):
        cell.cycle(step(0, 0.01 * k))
    cell.cycles(101, None)
    assert_stopped(cell, "timeout")
    where = cell.mock.measured
    cell.mock.restart()
    assert cell.mock.running and not cell.mock.flag and cell.mock.reason == ""
    assert cell.mock.start_pose == where
    assert cell.cycle(ZERO).measured == pytest.approx(where, abs=1e-8)


def test_restart_outside_the_soft_limits_is_refused():
    with pytest.raises(JointRangeError, match="A2"):
        Cell().mock.restart(ZERO)


def test_j_replies_for_another_sentype_count_as_missing():
    cell = Cell()
    other = SensorEncoder("KROSHU", AXES)
    for _ in range(100):
        cell.cycle(ZERO, encoder=other)
    assert_stopped(cell, "timeout")
    assert cell.mock.counters["wrong_sentype"] == 100 == cell.mock.counters["missed"]


def test_unusable_replies_count_as_missing():
    cell = Cell()
    for data in (b"", b"garbage", b"<Sen Type='ImFree'><IPOC>4</IPOC></Sen>", b"\xff" * 2000):
        cell.mock.begin_cycle()
        assert not cell.mock.receive(data)
    assert cell.cycle(ZERO).missed == 4
    assert cell.mock.counters["malformed"] == 4


@pytest.mark.parametrize(
    "first, after",
    [(2**32 - 10, [2**32 - 10, 2**32 - 6, 2**32 - 2, 2, 6]), (2**32 + 4, [2**32 + 4 * k for k in range(1, 6)])],
)
def test_an_ipoc_of_32_bits_wraps_and_a_larger_one_does_not(first, after):
    cell = Cell(first_stamp=first)
    assert [packet.controller_ms for packet in cell.cycles(5)] == after
    assert cell.mock.counters["missed"] == 0
    # a reply to the telegram before the wrap is late, as elsewhere
    cell.cycle(ZERO, ipoc_offset=after[1] - (after[-1] + 4))
    assert cell.mock.counters["late_replies"] == 1
    cell.mock.restart()
    assert cell.mock.stamp == (after[-1] + 4 + cell.mock.config.restart_gap)
