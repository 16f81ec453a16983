"""Torques (GearTorque) and motor currents (MACur): from the mock to their messages, refused and counted where unreadable."""

from __future__ import annotations

import math
from collections import deque

import pytest
from chain_samples import ROBOT, SETTINGS
from hypothesis import given
from hypothesis import strategies as st
from processes import ROOT

from construction_twin.controller.port import MockStatus
from construction_twin.core.axis_quantities import CURRENT, QUANTITIES, TORQUE
from construction_twin.core.errors import TelegramError
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.inbox import TelegramInbox
from construction_twin.mock.config import MockConfig
from construction_twin.mqtt.messages import StateProperties, read_report
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.rsi.axis_channels import AxisReader, quantity_of, told_axes
from construction_twin.rsi.controller_codec import RobotEncoder
from construction_twin.rsi.ethernet_xml import check_gateway
from construction_twin.rsi.gateway_codec import RobotDecoder
from construction_twin.rsi.make import MAKE

TEXT = (ROOT / "config/torque_ethernet.xml").read_text()
CONFIG = gateway_config(ROBOT, SETTINGS | {"decimals": 3, "cycle": 4, "ethernet_xml": TEXT})
PLAIN = gateway_config(ROBOT, SETTINGS | {"decimals": 3, "cycle": 4})
AXES, FILE, START = CONFIG.axes, CONFIG.layout, ROBOT.home
POSE = (0.0,) * 6
SEND = ("AIPos", "ASPos", *(f"GearTorque.{axis}" for axis in AXES), "Delay")
TORQUES = (120.5, -1315.904, -1327.068, 0.0, -0.25, 3.0)
CURRENTS = (1.5, -12.25, -14.5, 0.0, 99.9, -100.0)


def telegram(torques=TORQUES, send=SEND, ipoc=1000, currents=CURRENTS):
    return RobotEncoder(AXES, 6, send).encode(
        ipoc, START, START, POSE, POSE, 0, told={TORQUE: torques, CURRENT: currents}
    )


@given(st.lists(st.floats(-1e5, 1e5), min_size=6, max_size=6))
def test_what_a_controller_tells_is_read(torques):
    read = AxisReader(TORQUE, AXES, AXES).read(telegram(torques))
    assert read == pytest.approx(torques, abs=1e-6)


@given(st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6))
def test_currents_are_one_block_that_the_controller_has_itself(currents):
    data = telegram(send=("AIPos", "MACur", "Delay", "GearTorque.A1"), currents=currents)
    assert data.count(b"<MACur A1=") == 1
    read = AxisReader(CURRENT, AXES, AXES).read(data)
    assert read == pytest.approx(currents, abs=1e-6)
    # the torques of the same telegram are read beside them
    assert AxisReader(TORQUE, AXES, ("A1",)).read(data)[0] == 120.5


def test_an_arm_with_fewer_or_other_axes_reads_those_that_it_has():
    axes = ("E1", "A2", "A1")
    data = RobotEncoder(axes, 6, ("AIPos", "EIPos", "MACur")).encode(
        1000, (0.0,) * 3, (0.0,) * 3, POSE, POSE, 0, told={CURRENT: (0.0, 2.0, 1.0)}
    )
    assert b'<MACur A1="1.000000" A2="2.000000" A3="0.000000"' in data
    read = AxisReader(CURRENT, axes, told_axes(CURRENT, ("MACur",))).read(data)
    assert math.isnan(read[0]) and read[1:] == (2.0, 1.0)


@pytest.mark.parametrize(
    ("tag", "quantity"),
    [("MACur", CURRENT), ("GearTorque.A6", TORQUE), ("GearTorque", None), ("GearTorque.A7", None), ("GearTorque.E1", None),
     ("MACur.A1", None), ("MECur", None), ("AIPos", None)],
)  # fmt: skip
def test_a_tag_tells_one_quantity_or_none(tag, quantity):
    assert quantity_of(tag) is quantity


def test_they_stand_in_one_element_and_in_any_order():
    send = ("GearTorque.A3", "AIPos", "ASPos", "Delay", "GearTorque.A1")
    data = telegram(send=send)
    assert data.count(b"<GearTorque ") == 1
    assert told_axes(TORQUE, send) == ("A3", "A1")
    read = AxisReader(TORQUE, AXES, told_axes(TORQUE, send)).read(data)
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
    assert AxisReader(TORQUE, AXES, AXES).read(data.replace(*change)) is None


@pytest.mark.parametrize(
    "change",
    [
        (b'A3="-14.500000"', b'A3="-1000.1"'),
        (b'A3="-14.500000"', b'A3="inf"'),
        (b'A3="-14.500000"', b'A3="14 A"'),
        (b'A3="-14.500000"', b'A3=""'),
        (b'A3="-14.500000"', b""),
        (b'A3="-14.500000"', b'A3="1" A3="1"'),
        (b"<MACur ", b"<MECur "),
        (b"<MACur ", b'<MACur A1="1"/><MACur '),
    ],
)
def test_currents_that_cannot_be_read_tell_nothing(change):
    data = telegram(send=("AIPos", "MACur"))
    assert change[0] in data and AxisReader(CURRENT, AXES, AXES).read(data) is not None
    assert AxisReader(CURRENT, AXES, AXES).read(data.replace(*change)) is None


@pytest.mark.parametrize(("quantity", "element"), [(TORQUE, b"GearTorque"), (CURRENT, b"MACur")])
@given(st.binary(max_size=300))
def test_any_bytes_tell_a_quantity_or_nothing(quantity, element, inside):
    read = AxisReader(quantity, AXES, AXES).read(b"<Rob><" + element + b" " + inside + b"/></Rob>")
    assert read is None or (len(read) == 6 and all(abs(value) <= quantity.most for value in read))


def test_the_file_fits_a_gateway_and_one_without_the_channels_costs_nothing():
    check_gateway(FILE, AXES, "file")
    assert told_axes(TORQUE, FILE.send) == told_axes(CURRENT, FILE.send) == AXES
    assert tuple(MAKE.reader(CONFIG).told) == QUANTITIES
    assert not MAKE.reader(PLAIN).told


def inbox_of(*datagrams):
    gateway = Gateway(CONFIG, "run")
    waiting = deque(datagrams)

    def receive():
        if not waiting:
            raise BlockingIOError
        return waiting.popleft(), 0, ("127.0.0.1", 1)

    return gateway, TelegramInbox(gateway, receive, lambda: NANOSECONDS)


def test_what_is_malformed_is_counted_and_ends_no_answer():
    send = (*SEND, "MACur")
    good, bad = telegram(ipoc=1000, send=send), telegram(ipoc=1004, send=send).replace(b"-1327.068000", b"x")
    gateway, inbox = inbox_of(good)
    beside = StateProperties(7, 11, 0)
    assert inbox.newest().telegram.controller_ms == 1000
    for (quantity, payload), wanted in zip(gateway.told_messages(beside), (TORQUES, CURRENTS), strict=True):
        report = read_report(quantity, payload, 6)
        assert (report.seq, report.stamp, report.values) == (7, 11, wanted)
    # what was told once is not told again with the next pose
    assert gateway.told_messages(beside) == []
    gateway, inbox = inbox_of(bad)
    assert inbox.newest().telegram.controller_ms == 1004
    # that one cannot be read says nothing of the other
    assert [quantity for quantity, _ in gateway.told_messages(beside)] == [CURRENT]
    assert gateway.counters["torque_channels_unreadable"] == 1 and gateway.counters["current_channels_unreadable"] == 0


def test_a_mock_that_knows_no_torques_leaves_their_elements_out():
    wide = (7.0,) * 6
    mock = MockConfig(AXES, START, tuple(-q for q in wide), wide, wide, wide, layout=FILE)
    encode = MAKE.controller_side(mock).encode
    values = 1000, START, START, POSE, POSE, 0, MockStatus(), {}, {}
    bare, full = encode(*values, {}), encode(*values, {TORQUE: TORQUES, CURRENT: CURRENTS})
    assert b"GearTorque" not in bare and b"MACur" not in bare
    assert b"<GearTorque A1=" in full and b"<MACur A1=" in full
    with pytest.raises(TelegramError, match="GearTorque"):
        RobotEncoder(AXES, 6, SEND).encode(1000, START, START, POSE, POSE, 0)
