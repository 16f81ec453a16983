"""The optional channels GearTorque.A1 to A6: from the mock to the message on `torque`, refused and counted where unreadable."""

from __future__ import annotations

import math
from collections import deque

import pytest
from chain_samples import ROBOT, SETTINGS
from hypothesis import given
from hypothesis import strategies as st
from processes import ROOT

from construction_twin.controller.port import MockStatus
from construction_twin.core.errors import TelegramError
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.inbox import TelegramInbox
from construction_twin.mock.config import MockConfig
from construction_twin.mqtt.messages import StateProperties, read_torques
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.rsi.controller_codec import RobotEncoder
from construction_twin.rsi.ethernet_xml import check_gateway
from construction_twin.rsi.gateway_codec import RobotDecoder
from construction_twin.rsi.make import MAKE
from construction_twin.rsi.torque_channels import TorqueReader, torque_axes

TEXT = (ROOT / "config/torque_ethernet.xml").read_text()
CONFIG = gateway_config(ROBOT, SETTINGS | {"decimals": 3, "cycle": 4, "ethernet_xml": TEXT})
PLAIN = gateway_config(ROBOT, SETTINGS | {"decimals": 3, "cycle": 4})
AXES, FILE, START = CONFIG.axes, CONFIG.layout, ROBOT.home
POSE = (0.0,) * 6
SEND = ("AIPos", "ASPos", *(f"GearTorque.{axis}" for axis in AXES), "Delay")
TORQUES = (120.5, -1315.904, -1327.068, 0.0, -0.25, 3.0)


def telegram(torques=TORQUES, send=SEND, ipoc=1000):
    return RobotEncoder(AXES, 6, send).encode(ipoc, START, START, POSE, POSE, 0, torques=torques)


@given(st.lists(st.floats(-1e5, 1e5), min_size=6, max_size=6))
def test_what_a_controller_tells_is_read(torques):
    read = TorqueReader(AXES, AXES).read(telegram(torques))
    assert read == pytest.approx(torques, abs=1e-6)


def test_they_stand_in_one_element_and_in_any_order():
    send = ("GearTorque.A3", "AIPos", "ASPos", "Delay", "GearTorque.A1")
    data = telegram(send=send)
    assert data.count(b"<GearTorque ") == 1
    assert torque_axes(send) == ("A3", "A1")
    read = TorqueReader(AXES, torque_axes(send)).read(data)
    assert read[:3:2] == (120.5, -1327.068) and all(map(math.isnan, (read[1], *read[3:])))


def test_the_codec_reads_such_telegrams_as_any_other_and_learns_their_shape():
    decoder = RobotDecoder(AXES)
    for k in range(5):
        read = decoder.parse(telegram(torques=[k * value for value in TORQUES], ipoc=1000 + 4 * k))
        assert (read.controller_ms, read.measured) == (1000 + 4 * k, pytest.approx(START, abs=1e-8))


@pytest.mark.parametrize(
    "change",
    [
        (b'A3="-1327.068000"', b'A3="much"'),
        (b'A3="-1327.068000"', b'A3="nan"'),
        (b'A3="-1327.068000"', b'A3="1e99"'),
        (b'A3="-1327.068000"', b'A3="-1000000.1"'),
        (b'A3="-1327.068000"', b""),
        (b'A3="-1327.068000"', b'A3="1" A3="2"'),
        (b"<GearTorque ", b"<Torque "),
        (b"<GearTorque ", b'<GearTorque A1="1"/><GearTorque '),
    ],
)
def test_what_cannot_be_read_tells_nothing(change):
    data = telegram()
    assert change[0] in data
    assert TorqueReader(AXES, AXES).read(data.replace(*change)) is None


@given(st.binary(max_size=300))
def test_any_bytes_tell_torques_or_nothing(inside):
    read = TorqueReader(AXES, AXES).read(b"<Rob><GearTorque " + inside + b"/></Rob>")
    assert read is None or (len(read) == 6 and all(abs(value) <= 1e6 for value in read))


def test_the_file_fits_a_gateway_and_one_without_the_channels_costs_nothing():
    check_gateway(FILE, AXES, "file")
    assert torque_axes(FILE.send) == AXES
    assert MAKE.reader(CONFIG).torques is not None
    assert MAKE.reader(PLAIN).torques is None


def inbox_of(*datagrams):
    gateway = Gateway(CONFIG, "run")
    waiting = deque(datagrams)

    def receive():
        if not waiting:
            raise BlockingIOError
        return waiting.popleft(), 0, ("127.0.0.1", 1)

    return gateway, TelegramInbox(gateway, receive, lambda: NANOSECONDS)


def test_what_is_malformed_is_counted_and_ends_no_answer():
    good, bad = telegram(ipoc=1000), telegram(ipoc=1004).replace(b"-1327.068000", b"x")
    gateway, inbox = inbox_of(good)
    beside = StateProperties(7, 11, 0)
    assert inbox.newest().telegram.controller_ms == 1000
    report = read_torques(gateway.torque_message(beside), 6)
    assert (report.seq, report.stamp, report.torques) == (7, 11, TORQUES)
    # what was told once is not told again with the next pose
    assert gateway.torque_message(beside) is None
    gateway, inbox = inbox_of(bad)
    assert inbox.newest().telegram.controller_ms == 1004
    assert gateway.torque_message(beside) is None
    assert gateway.counters["torque_channels_unreadable"] == 1


def test_a_mock_that_knows_no_torques_leaves_their_element_out():
    wide = (7.0,) * 6
    mock = MockConfig(AXES, START, tuple(-q for q in wide), wide, wide, wide, layout=FILE)
    encode = MAKE.controller_side(mock).encode
    values = 1000, START, START, POSE, POSE, 0, MockStatus(), {}, {}
    assert b"GearTorque" not in encode(*values) and b"<GearTorque A1=" in encode(*values, TORQUES)
    with pytest.raises(TelegramError, match="GearTorque"):
        RobotEncoder(AXES, 6, SEND).encode(1000, START, START, POSE, POSE, 0)
