"""The mock controller with an Ethernet XML: ONLYSEND, the STOP object, HOLDON per channel, other names, a track."""

from __future__ import annotations

import dataclasses

import pytest

from construction_twin.controller.telegram import AxisUnit
from construction_twin.mock.config import MockConfig
from construction_twin.mock.controller import MockController
from construction_twin.mock.servo import IdealServo
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder
from construction_twin.rsi.layout import RsiLayout

#: A track in m, two axes in rad.
AXES = ("E1", "A1", "A2")
UNITS = (AxisUnit(linear=True), AxisUnit(), AxisUnit())
PLAIN = RsiLayout.plain(AXES)
LAYOUT = dataclasses.replace(PLAIN, receive=("Stop", *PLAIN.receive), holdon=(False, *PLAIN.holdon))
START = (1.5, 0.1, -1.0)
CONFIG = MockConfig(AXES, START, (-2.0, -3.0, -2.0), (5.0, 3.0, 2.0), (2.5, 2.0, 2.0), (6.8, 2.5, 2.5), LAYOUT, UNITS)
ZERO = (0.0, 0.0, 0.0)


class Cell:
    """A mock controller and a PC that answers as told."""

    def __init__(self, **changes):
        self.config = dataclasses.replace(CONFIG, **changes)
        self.mock = MockController(self.config, IdealServo(1), lambda q: (q[:3], q[:3]))
        self.encoder = (
            None if self.config.layout.onlysend else SensorEncoder.of(self.config.layout, AXES, self.config.units)
        )
        self.decoder = RobotDecoder(AXES, self.config.units)

    def cycle(self, correction=ZERO, stop=None):
        data = self.mock.begin_cycle()
        if data is None:
            return None
        packet = self.decoder.parse(data)
        if correction is not None:
            self.mock.receive(self.encoder.encode(correction, packet.controller_ms, stop))
        return packet


def test_a_track_is_corrected_in_millimetres_and_reported_in_metres():
    cell = Cell()
    for k in range(50):
        cell.cycle((0.001 * k, 0.0, 0.0))
    packet = cell.cycle((0.05, 0.0, 0.0))
    assert packet.setpoint == pytest.approx(START)
    assert packet.measured == pytest.approx((1.549, 0.1, -1.0), abs=1e-8)
    assert cell.mock.running


# -- the STOP object ---------------------------------------------------------------------------------------------------


def test_stop_ends_the_motion_on_its_rising_edge():
    cell = Cell()
    for _ in range(5):
        cell.cycle(stop=False)
    cell.cycle(stop=True)
    assert cell.cycle() is None
    assert cell.mock.reason == "stop: requested by the PC, RSI_MOVECORR ended"
    assert not cell.mock.flag


def answer_without_stop(cell, correction=ZERO):
    """Run a cycle whose reply has corrections and IPOC only, as ROS-Industrial's driver sends them."""
    ipoc = cell.decoder.parse(cell.mock.begin_cycle()).controller_ms
    return cell.mock.receive(SensorEncoder("ImFree", AXES, (), UNITS).encode(correction, ipoc))


def test_a_reply_without_the_declared_stop_counts_and_is_counted():
    cell = Cell()
    for k in range(20):
        assert answer_without_stop(cell, (0.001 * k, 0.0, 0.0))
    packet = cell.cycle((0.02, 0.0, 0.0))
    assert packet.measured[0] == pytest.approx(1.519, abs=1e-7) and packet.missed == 0
    assert (cell.mock.counters["missed"], cell.mock.counters["without_stop"]) == (0, 20)
    cell.cycle(stop=True)
    assert cell.cycle() is None


# -- HOLDON, ONLYSEND, names -------------------------------------------------------------------------------------------


def test_each_channel_falls_back_as_its_own_holdon_says():
    layout = dataclasses.replace(LAYOUT, holdon=(False, True, False, True))
    cell = Cell(layout=layout, velocity_factor=0.0, acceleration_factor=0.0)
    cell.cycle((0.01, 0.01, 0.01))
    cell.cycle(None)
    cell.cycle(None)
    assert cell.mock.applied == pytest.approx((0.01, 0.0, 0.01), abs=1e-7)


def test_with_onlysend_it_sends_for_ever_expects_nothing_and_takes_nothing():
    cell = Cell(layout=dataclasses.replace(PLAIN, onlysend=True, receive=(), holdon=()), timeout=10)
    packets = [cell.cycle(None) for _ in range(500)]
    assert None not in packets
    assert {packet.missed for packet in packets} == {0}
    reply = SensorEncoder("ImFree", AXES, (), UNITS).encode((0.01, 0.0, 0.0), packets[-1].controller_ms)
    assert not cell.mock.receive(reply)
    assert cell.cycle(None).measured == pytest.approx(START)
    assert (cell.mock.counters["unexpected"], cell.mock.counters["missed"], cell.mock.flag) == (1, 0, False)
