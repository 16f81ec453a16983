"""RSI telegrams as an Ethernet XML declares them: names, order, Stop, external and linear axes, units."""

from __future__ import annotations

import dataclasses
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.controller.telegram import AxisUnit
from construction_twin.core.errors import ConfigurationError, TelegramError
from construction_twin.rsi.controller_codec import RobotEncoder, SensorDecoder
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder
from construction_twin.rsi.layout import RsiLayout

#: The track first, as other drivers order their joints; the XML has it last.
AXES = ("E1", "A1", "A2", "A3", "A4", "A5", "A6")
UNITS = (AxisUnit(linear=True), *(AxisUnit(),) * 6)
LAYOUT = dataclasses.replace(
    RsiLayout.plain(AXES),
    sentype="KROSHU",
    receive=("Stop", *(f"AKorr.A{i}" for i in (2, 1, 3, 4, 5, 6)), "EKorr.E1"),
    holdon=(False, *(True,) * 7),
)
POSE = (0.0,) * 6
Q = (1.25, *map(math.radians, (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)))


def encode(q, units=UNITS, precision=4):
    return RobotEncoder(AXES, precision, LAYOUT.send, units).encode(8, q, q, POSE, POSE, 3)


def test_a_track_stands_in_its_own_blocks_in_millimetres():
    data = encode(Q).decode()
    assert re.findall(r"<(\w+)", data) == ["Rob", "RIst", "RSol", "AIPos", "ASPos", "EIPos", "ESPos", "Delay", "IPOC"]
    rest = " ".join(f'E{i}="0.0000"' for i in range(2, 7))
    assert f'<EIPos E1="1250.0000" {rest}/><ESPos E1="1250.0000" {rest}/>' in data
    assert '<AIPos A1="0.0000" A2="-90.0000"' in data


def test_a_packet_of_a_track_is_read_in_metres():
    telegram = RobotDecoder(AXES, UNITS).parse(encode(Q))
    assert telegram.measured == pytest.approx(Q) and telegram.setpoint == pytest.approx(Q)
    assert (telegram.controller_ms, telegram.missed) == (8, 3)


def test_blocks_come_in_the_files_order_and_an_unknown_one_is_refused():
    data = RobotEncoder(AXES, 1, ("Delay", "EIPos", "AIPos"), UNITS).encode(4, Q, Q, POSE, POSE, 0).decode()
    assert re.findall(r"<(\w+)", data) == ["Rob", "Delay", "EIPos", "AIPos", "IPOC"]
    with pytest.raises(ConfigurationError, match="MECur"):
        RobotEncoder(AXES, 1, ("MECur",), UNITS)


def test_a_reply_has_the_files_names_order_and_stop():
    data = SensorEncoder.of(LAYOUT, AXES, UNITS).encode((0.002, *map(math.radians, (1, 2, 3, 4, 5, 6))), 12)
    assert data == (
        b'<Sen Type="KROSHU"><Stop>0</Stop><AKorr A2="2.000000" A1="1.000000" A3="3.000000" A4="4.000000" A5="5.000000" '
        b'A6="6.000000"/><EKorr E1="2.000000"/><IPOC>12</IPOC></Sen>'
    )


def test_stop_is_sent_where_it_is_declared():
    encoder = SensorEncoder.of(LAYOUT, AXES, UNITS)
    assert b"<Stop>1</Stop>" in encoder.encode(POSE + (0.0,), 4, stop=True)
    last = dataclasses.replace(LAYOUT, receive=(*LAYOUT.receive[1:], "Stop"))
    assert b"<Stop>0</Stop><IPOC>" in SensorEncoder.of(last, AXES, UNITS).encode(POSE + (0.0,), 4)
    assert b"Stop" not in SensorEncoder("ImFree", AXES).encode(POSE + (0.0,), 4)


@pytest.mark.parametrize("missing, said", [(b"EIPos", "EIPos"), (b"ASPos", "ASPos")])
def test_half_a_position_is_refused(missing, said):
    data = re.sub(rb"<%s [^>]*/>" % missing, b"", encode(Q))
    with pytest.raises(TelegramError, match=f"no {said}") as caught:
        RobotDecoder(AXES, UNITS).parse(data)
    assert caught.value.reason == "element"


# -- units ------------------------------------------------------------------------------------------------------------


def test_sign_and_offset_of_a_track_are_the_controllers():
    units = (AxisUnit(linear=True, sign=-1, offset=0.15), *UNITS[1:])
    data = encode((2.0, *Q[1:]), units)
    # -1 * 2 m + 0.15 m
    assert b'<EIPos E1="-1850.0000"' in data
    assert RobotDecoder(AXES, units).parse(data).measured[0] == pytest.approx(2.0)
    # a correction turns with the sign, and knows no offset
    assert b'E1="-2.000000"' in SensorEncoder.of(LAYOUT, AXES, units).encode((0.002, *(0.0,) * 6), 4)


@given(
    st.floats(-30.0, 30.0),
    st.booleans(),
    st.sampled_from([1, -1]),
    st.floats(-10.0, 10.0),
    st.floats(0.01, 100.0),
    st.floats(0.01, 100.0),
)
def test_positions_and_corrections_survive_any_unit(value, linear, sign, offset, feedback, correction):
    unit = AxisUnit(linear, sign, offset, feedback, correction)
    encoder, decoder = RobotEncoder(("E1",), 6, ("EIPos", "ESPos"), (unit,)), RobotDecoder(("E1",), (unit,))
    telegram = decoder.parse(encoder.encode(4, (value,), (offset,), POSE, POSE, 0))
    step = 1e-6 / abs(unit.feedback_factor)
    assert telegram.measured == pytest.approx((value,), abs=step + 1e-9)
    assert telegram.setpoint == pytest.approx((offset,), abs=step + 1e-9)
    reply = SensorEncoder("ImFree", ("E1",), (), (unit,)).encode((value,), 4)
    read = SensorDecoder("ImFree", ("E1",), (), (unit,)).parse(reply).target
    assert read == pytest.approx((value,), abs=1e-6 / abs(unit.correction_factor) + 1e-9)
