"""RSI telegrams: golden bytes, round trips, and hostile input that must end in TelegramError."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.controller.telegram import Reply, Telegram
from construction_twin.core.errors import TelegramError
from construction_twin.core.network import MAX_TELEGRAM
from construction_twin.core.units import radians
from construction_twin.rsi.controller_codec import RobotEncoder, SensorDecoder
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
HOME = radians((0, -90, 90, 0, 90, 0))
POSE = (1.35, 0.0, 1.569, math.pi, 0.0, math.pi)
#: The example of docs/rsi.md, section 2, written out: KE's set of blocks at Precision 4.
GOLDEN_ROB = (
    b'<Rob Type="KUKA"><RIst X="1350.0000" Y="0.0000" Z="1569.0000" A="180.0000" B="0.0000" C="180.0000"/>'
    b'<RSol X="1350.0000" Y="0.0000" Z="1569.0000" A="180.0000" B="0.0000" C="180.0000"/>'
    b'<AIPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/>'
    b'<ASPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/>'
    b'<Delay D="0"/><IPOC>4208163634</IPOC></Rob>'
)
GOLDEN_SEN = (
    b'<Sen Type="ImFree"><AK A1="0.012500" A2="-0.300000" A3="0.000000" A4="0.000000" A5="0.000000" A6="0.000000"/>'
    b"<IPOC>4208163634</IPOC></Sen>"
)
CORRECTION = radians((0.0125, -0.3, 0, 0, 0, 0))

angles = st.floats(-100.0, 100.0, allow_nan=False)
six_angles = st.tuples(*[angles] * 6)
ipocs = st.integers(0, 2**64 - 1)


def rob(inner: str) -> bytes:
    return f"<Rob Type='KUKA'>{inner}</Rob>".encode()


def aipos(**changes: str) -> str:
    values = dict.fromkeys(AXES, "1.5") | changes
    return "<AIPos " + " ".join(f'{name}="{value}"' for name, value in values.items()) + "/>"


def refused(data: bytes) -> str:
    with pytest.raises(TelegramError) as caught:
        RobotDecoder(AXES).parse(data)
    return caught.value.reason


def test_robot_telegram_has_the_golden_bytes():
    assert RobotEncoder(AXES, 4).encode(4208163634, HOME, HOME, POSE, POSE, 0) == GOLDEN_ROB


def test_golden_robot_telegram_is_read():
    assert RobotDecoder(AXES).parse(GOLDEN_ROB) == Telegram(4208163634, HOME, HOME, 0)


def test_sensor_telegram_has_the_golden_bytes():
    encoder = SensorEncoder("ImFree", AXES)
    assert encoder.encode(CORRECTION, 4208163634) == GOLDEN_SEN
    assert b"<Stop>1</Stop><AK " in encoder.encode(CORRECTION, 4, stop=True)
    assert b'<Sen Type="ImFree"><Stop>0</Stop>' in encoder.encode(CORRECTION, 4, stop=False)


def test_golden_sensor_telegram_is_read():
    assert SensorDecoder("ImFree", AXES).parse(GOLDEN_SEN) == Reply(4208163634, CORRECTION, None)


def test_zero_has_no_sign_in_either_direction():
    tiny = (-1e-12,) * 6
    assert b"-0.0" not in SensorEncoder("ImFree", AXES).encode(tiny, 1)
    assert b"-0.0" not in RobotEncoder(AXES, 3).encode(1, tiny, tiny, tiny, tiny, 0)
    assert b'A1="-0.000001"' in SensorEncoder("ImFree", AXES).encode(radians((-1e-6,) * 6), 1)


def test_axis_names_choose_the_attributes_and_their_order():
    telegram = RobotDecoder(("A6", "A2")).parse(rob(aipos(A2="-90.0", A6="7") + "<IPOC>12</IPOC>"))
    assert telegram.measured == radians((7, -90))
    assert telegram.setpoint is None and telegram.missed is None


def test_nearly_empty_first_packet_is_legal():
    telegram = RobotDecoder(AXES).parse(b"<Rob TYPE='KUKA'><IPOC>123645634563</IPOC></Rob>")
    assert telegram == Telegram(123645634563, None, None, None)


def test_unknown_elements_white_space_and_root_attribute_do_not_matter():
    data = rob(f"\n <Digout o1='1' /> {aipos()} <EStr>hello</EStr><Source1>x</Source1>\n<IPOC>8</IPOC>\n")
    assert RobotDecoder(AXES).parse(data).measured == radians((1.5,) * 6)
    assert RobotDecoder(AXES).parse(b"<Rob><IPOC>8</IPOC></Rob>").controller_ms == 8


@pytest.mark.parametrize(
    "number",
    "nan|inf|-inf|1e|1e+|e5|1e5.0|1e 5|1e999|1e-9999|1e100|1_0| 1|1 |1 0||-|.|1.|.5|1,5|0x10|--1".split("|")
    + ["1" * 400],
)
def test_numbers_that_are_no_finite_decimals_are_refused(number):
    assert refused(rob(aipos(A3=number) + "<IPOC>8</IPOC>")) == "number"


@pytest.mark.parametrize(
    "number, value",
    [
        ("1e-06", 1e-6),
        ("-9.0E+01", -90.0),
        ("1.5e1", 15.0),
        ("4e-320", 4e-320),
        ("2e+001", 20.0),
        ("9e+99", 9e99),
    ],
)
def test_numbers_with_an_exponent_are_read_as_python_senders_write_them(number, value):
    parsed = RobotDecoder(AXES).parse(rob(aipos(A3=number) + "<IPOC>8</IPOC>")).measured[2]
    assert parsed == math.radians(value) and math.isfinite(parsed)


DECLARATIONS = [
    b"<?xml version='1.0'?>",
    b'<?xml version="1.0" encoding="UTF-8"?>\r\n',
    b"<?xml version='1.0' encoding='utf8'?>\n",
    b"<?xml version='1.0' encoding='us-ascii' standalone='yes' ?>\n  ",
    b'<?xml version="1.1" encoding="ISO-8859-1"?>',
]


@pytest.mark.parametrize("declaration", DECLARATIONS)
def test_an_xml_declaration_is_read_over_from_a_controller(declaration):
    data = rob(f"{aipos()}<IPOC>8</IPOC>")
    assert RobotDecoder(AXES).parse(declaration + data) == RobotDecoder(AXES).parse(data)


@pytest.mark.parametrize(
    "declaration",
    [
        b"<?xml version='1.0' encoding='cp037'?>",
        b"<?xml version='1.0' encoding='utf-16'?>",
        b"<?xml version='1.0' encoding='utf-7'?>",
        b"<?xml encoding='utf-8'?>",
        b"<?xml version='1.0\"?>",
        b" <?xml version='1.0'?>",
        b"<?xml version='1.0'?><?xml version='1.0'?>",
        b"<?xml version='1.0'?><!DOCTYPE Rob [<!ENTITY a 'b'>]>",
        b"<?php version='1.0'?>",
    ],
)
def test_other_markup_before_the_telegram_is_refused(declaration):
    assert refused(declaration + rob(f"{aipos()}<IPOC>8</IPOC>")) == "markup"


@pytest.mark.parametrize(
    "inner",
    [
        "",
        "<IPOC></IPOC>",
        "<IPOC>-4</IPOC>",
        "<IPOC>4.0</IPOC>",
        "<IPOC>4 </IPOC>",
        "<IPOC>1e3</IPOC>",
        "<IPOC>18446744073709551616</IPOC>",
        "<IPOC>" + "1" * 5000 + "</IPOC>",
        "<IPOC>4</IPOC><IPOC>4</IPOC>",
        "<IPOC>4<A/></IPOC>",
        "<Nested><IPOC>4</IPOC></Nested>",
    ],
)
def test_ipoc_must_be_there_once_and_whole(inner):
    assert refused(rob(inner)) == "ipoc"


@pytest.mark.parametrize(
    "data, reason",
    [
        (b"", "size"),
        (b"<Rob>" + b" " * MAX_TELEGRAM + b"</Rob>", "size"),
        (b"\xff\xfe\x00", "encoding"),
        ("<Rob><X>ä</X><IPOC>4</IPOC></Rob>".encode(), "encoding"),
        (b"<Rob><?xml version='1.0'?><IPOC>4</IPOC></Rob>", "markup"),
        (b"<!DOCTYPE Rob [<!ENTITY a 'b'>]><Rob><IPOC>4</IPOC></Rob>", "markup"),
        (b"<Rob><!-- --><IPOC>4</IPOC></Rob>", "markup"),
        (b"<Rob><![CDATA[x]]><IPOC>4</IPOC></Rob>", "markup"),
        ("<!DOCTYPE Rob []><Rob/>".encode("utf-16-le"), "encoding"),
        (b"<Rob><IPOC>4</IPOC>", "xml"),
        (b"<Rob><IPOC>4</IPOC></Rob><Rob/>", "xml"),
        (b"<Rob><IPOC>&a;</IPOC></Rob>", "xml"),
        (b"\x00" * 10, "encoding"),
        (b"hello", "xml"),
        (b"<a:Rob><IPOC>4</IPOC></a:Rob>", "xml"),
        (b"<Sen><IPOC>4</IPOC></Sen>", "root"),
        (b"<Rob><Delay D='x'/><IPOC>4</IPOC></Rob>", "number"),
        (b"<Rob><Delay/><IPOC>4</IPOC></Rob>", "number"),
        (b"<Rob><AIPos A1='1'/><IPOC>4</IPOC></Rob>", "attribute"),
        (b"<Rob><Delay D='0'/><Delay D='1'/><IPOC>4</IPOC></Rob>", "element"),
    ],
)
def test_malformed_telegrams_are_refused_with_their_reason(data, reason):
    assert refused(data) == reason


@pytest.mark.parametrize(
    "old, new, reason",
    [
        (b"ImFree", b"KROSHU", "sentype"),
        (b' Type="ImFree"', b"", "sentype"),
        (b"<Sen ", b"<Rob ", "xml"),
        (b'A6="0.000000"', b"", "attribute"),
        (b"0.012500", b"nan", "number"),
        (b"<IPOC>", b"<Stop>2</Stop><IPOC>", "number"),
        (b"<IPOC>4208163634</IPOC>", b"", "ipoc"),
    ],
)
def test_unusable_replies_are_refused_with_their_reason(old, new, reason):
    with pytest.raises(TelegramError) as caught:
        SensorDecoder("ImFree", AXES).parse(GOLDEN_SEN.replace(old, new))
    assert caught.value.reason == reason


@pytest.mark.parametrize("correction", [(0.0,) * 5, (0.0,) * 7, (math.nan,) + (0.0,) * 5, (0.0,) * 5 + (math.inf,)])
def test_corrections_that_cannot_be_sent_are_refused(correction):
    with pytest.raises(TelegramError) as caught:
        SensorEncoder("ImFree", AXES).encode(correction, 4)
    assert caught.value.reason == "number"


@given(six_angles, ipocs, st.sampled_from([None, False, True]))
def test_corrections_survive_the_wire_to_half_a_decimal(correction, ipoc, stop):
    telegram = SensorDecoder("ImFree", AXES).parse(SensorEncoder("ImFree", AXES).encode(correction, ipoc, stop))
    assert (telegram.controller_ms, telegram.stop) == (ipoc, stop)
    for sent, received in zip(correction, telegram.target):
        assert abs(sent - received) <= math.radians(0.5e-6) * (1 + 1e-6)


@given(six_angles, six_angles, ipocs, st.integers(0, 2**31), st.integers(1, 32))
def test_positions_survive_the_wire_to_half_a_decimal(measured, setpoint, ipoc, delay, precision):
    telegram = RobotDecoder(AXES).parse(
        RobotEncoder(AXES, precision).encode(ipoc, measured, setpoint, POSE, POSE, delay)
    )
    assert (telegram.controller_ms, telegram.missed) == (ipoc, delay)
    tolerance = math.radians(0.5 * 10.0**-precision) * (1 + 1e-6) + 1e-13
    for sent, received in zip(measured + setpoint, telegram.measured + telegram.setpoint):
        assert abs(sent - received) <= tolerance
