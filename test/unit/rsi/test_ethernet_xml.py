"""The RSI Ethernet XML: what is read from it, and one sentence for everything that does not fit."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import ROOT

from construction_twin.core.errors import ConfigurationError
from construction_twin.rsi.ethernet_xml import (
    MAX_BYTES,
    EthernetXmlError,
    check_gateway,
    load_ethernet_xml,
    read_ethernet_xml,
)
from construction_twin.rsi.gateway_codec import SensorEncoder
from construction_twin.rsi.layout import RsiLayout
from construction_twin.rsi.make import ethernet_xml_text

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
FILE = ROOT / "krl" / "ethernet" / "ctwin_ethernet.xml"
TEXT = FILE.read_text()
WITH_TRACK = (ROOT / "krl" / "ethernet" / "ctwin_e1_ethernet.xml").read_text()
#: As a user of another driver has it: other names, another order, signals that the gateway does not need.
OTHER = """<?xml version="1.0" encoding="ISO-8859-1"?>
<ROOT>
  <CONFIG><IP_NUMBER> 10.1.2.3 </IP_NUMBER><PORT>59152</PORT><PROTOCOL>UDP</PROTOCOL><SENTYPE>KROSHU</SENTYPE>
    <ONLYSEND>false</ONLYSEND></CONFIG>
  <SEND><ELEMENTS>
    <ELEMENT TAG="DEF_ASPos" TYPE="DOUBLE" INDX="INTERNAL" UNIT="0"/>
    <ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"/>
    <ELEMENT TAG="GearTorque.A1" TYPE="DOUBLE" INDX="3"/>
    <ELEMENT TAG="DEF_Tech.C1" TYPE="DOUBLE" INDX="INTERNAL"/>
    <ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/>
  </ELEMENTS></SEND>
  <RECEIVE><ELEMENTS>
    <ELEMENT TAG="AKorr.A2" TYPE="DOUBLE" INDX="2" HOLDON="1"/>
    <ELEMENT TAG="AKorr.A1" TYPE="DOUBLE" INDX="1" HOLDON="1"/>
    <ELEMENT TAG="Stop" TYPE="BOOL" INDX="9" HOLDON="0"/>
  </ELEMENTS></RECEIVE>
</ROOT>"""


def changed(old: str, new: str, text: str = TEXT) -> str:
    assert old in text
    return text.replace(old, new)


def refusal(text: str, axes=AXES) -> EthernetXmlError:
    with pytest.raises(EthernetXmlError) as caught:
        check_gateway(read_ethernet_xml(text, "eth.xml").layout, axes, "eth.xml")
    assert str(caught.value).startswith("eth.xml: ") and "expected" in str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value


def test_the_shipped_file_says_what_the_usual_layout_says_and_has_a_stop_channel():
    ethernet = load_ethernet_xml(FILE)
    plain = RsiLayout.plain(AXES)
    assert (ethernet.address, ethernet.layout.port, ethernet.layout.sentype) == ("192.168.1.10", 49152, "ImFree")
    assert ethernet.layout == dataclasses.replace(
        plain, receive=("Stop", *plain.receive), holdon=(False, *plain.holdon)
    )
    check_gateway(ethernet.layout, AXES, "eth.xml")


def test_names_order_and_holdon_are_those_of_the_file():
    ethernet = read_ethernet_xml(OTHER, "eth.xml")
    assert ethernet.address == "10.1.2.3"
    assert ethernet.layout == RsiLayout(
        sentype="KROSHU",
        port=59152,
        onlysend=False,
        send=("ASPos", "AIPos", "GearTorque.A1", "Tech.C1", "Delay"),
        receive=("AKorr.A2", "AKorr.A1", "Stop"),
        holdon=(True, True, False),
    )
    check_gateway(ethernet.layout, ("A1", "A2"), "eth.xml")


#: What stands in the driver's file for the KR C4: two Cartesian blocks in front, no Stop, eight digital outputs.
ROS_INDUSTRIAL = "".join(
    (
        "<ROOT><CONFIG><IP_NUMBER>192.168.1.25</IP_NUMBER><PORT>59152</PORT><SENTYPE>ImFree</SENTYPE>",
        "<ONLYSEND>FALSE</ONLYSEND></CONFIG><SEND><ELEMENTS>",
        *(
            f'<ELEMENT TAG="DEF_{name}" TYPE="{kind}" INDX="INTERNAL" />'
            for name, kind in (
                ("RIst", "DOUBLE"), ("RSol", "DOUBLE"), ("AIPos", "DOUBLE"), ("ASPos", "DOUBLE"), ("Delay", "LONG"),
            )
        ),
        "</ELEMENTS></SEND><RECEIVE><ELEMENTS>",
        *(f'<ELEMENT TAG="AK.A{axis}" TYPE="DOUBLE" INDX="{axis}" HOLDON="1" />' for axis in range(1, 7)),
        *(f'<ELEMENT TAG="Out.0{out}" TYPE="BOOL" INDX="{out + 6}" HOLDON="1" />' for out in range(1, 9)),
        "</ELEMENTS></RECEIVE></ROOT>",
    )
)  # fmt: skip


#: What stands in the file of kuka_drivers: no DEF_ASPos, because its driver's corrections are relative to AIPos; another SENTYPE.
KUKA_DRIVERS = "".join(
    (
        "<ROOT><CONFIG><IP_NUMBER>192.168.1.25</IP_NUMBER><PORT>59152</PORT><SENTYPE>KROSHU</SENTYPE>",
        "<ONLYSEND>FALSE</ONLYSEND></CONFIG><SEND><ELEMENTS>",
        '<ELEMENT TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL" /><ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL" />',
        '<ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL" /></ELEMENTS></SEND><RECEIVE><ELEMENTS>',
        *(f'<ELEMENT TAG="AK.A{axis}" TYPE="DOUBLE" INDX="{axis}" HOLDON="1" />' for axis in range(1, 7)),
        '<ELEMENT TAG="Stop" TYPE="BOOL" INDX="7" HOLDON="0" /></ELEMENTS></RECEIVE></ROOT>',
    )
)


def test_of_the_file_of_kuka_drivers_is_said_by_name_what_differs():
    error = refusal(KUKA_DRIVERS)
    assert error.element == "SEND DEF_ASPos"
    assert "kuka_drivers" in error.expected and "`reference: AIPos`" in error.expected
    aspos = '<ELEMENT TAG="DEF_ASPos" TYPE="DOUBLE" INDX="INTERNAL" />'
    check_gateway(
        read_ethernet_xml(KUKA_DRIVERS.replace("</ELEMENTS>", f"{aspos}</ELEMENTS>", 1), "eth").layout, AXES, "eth"
    )


@pytest.mark.parametrize(
    "codec, declared",
    [("latin-1", "ISO-8859-1"), ("cp1252", "windows-1252"), ("cp1252", ""), ("utf-8-sig", "UTF-8"), ("utf-8", "")],
)
def test_a_file_is_read_in_the_encodings_of_editors(tmp_path, codec, declared):
    path = tmp_path / "eth.xml"
    declaration = f'<?xml version="1.0" encoding="{declared}"?>' if declared else ""
    letters = "Prüfstand" if codec == "latin-1" else "Prüfstand – 5 €"
    path.write_bytes(f"{declaration}<!-- {letters} -->{TEXT}".encode(codec))
    assert load_ethernet_xml(path) == read_ethernet_xml(TEXT, "eth.xml")


def test_the_file_of_the_ros_industrial_driver_is_used_as_it_is():
    ethernet = read_ethernet_xml(ROS_INDUSTRIAL, "ros_rsi_ethernet.xml")
    layout = ethernet.layout
    check_gateway(layout, AXES, "ros_rsi_ethernet.xml")
    assert (ethernet.address, layout.port) == ("192.168.1.25", 59152)
    assert layout.send == ("RIst", "RSol", "AIPos", "ASPos", "Delay")
    assert layout.receive == RsiLayout.plain(AXES).receive
    assert layout.not_filled == tuple(f"Out.0{number}" for number in range(1, 9))
    assert b"Out" not in SensorEncoder.of(layout, AXES).encode((0.0,) * 6, 4)
    # an output of another type has a meaning that nobody knows here
    assert refusal(changed('"Out.03" TYPE="BOOL"', '"Out.03" TYPE="LONG"', ROS_INDUSTRIAL)).element == "RECEIVE Out.03"


def test_a_track_needs_its_channel_and_its_positions():
    axes = ("E1", *AXES)
    check_gateway(read_ethernet_xml(WITH_TRACK, "eth.xml").layout, axes, "eth.xml")
    assert refusal(TEXT, axes).element == "RECEIVE EK.E1"
    for block in ("DEF_EIPos", "DEF_ESPos"):
        line = f'      <ELEMENT TAG="{block}" TYPE="DOUBLE" INDX="INTERNAL"/>\n'
        assert refusal(changed(line, "", WITH_TRACK), axes).element == f"SEND {block}"


@pytest.mark.parametrize(
    "old, new, element, expected",
    [
        ('TAG="DEF_AIPos"', 'TAG="DEF_MACur"', "SEND DEF_AIPos", "the measured axes"),
        ('TAG="DEF_ASPos"', 'TAG="DEF_MACur"', "SEND DEF_ASPos", "relative to"),
        ('TAG="DEF_Delay" TYPE="LONG"', 'TAG="DEF_MECur" TYPE="LONG"', "SEND DEF_Delay", "would be a step"),
        ('TAG="AK.A4"', 'TAG="AK.E4"', "RECEIVE AK.E4", "the robot's axes A1, A2"),
        ('<ELEMENT TAG="AK.A4" TYPE="DOUBLE" INDX="5" HOLDON="1"/>', "", "RECEIVE AK.A4", "a correction channel for A4"),
        ('TAG="AK.A4"', 'TAG="AKorr.A4"', "RECEIVE AKorr", "one element for all of A1 to A6"),
        ('TAG="AK.A4"', 'TAG="AKorr.A3"', "RECEIVE AKorr.A3", "one channel per axis"),
        ('TAG="AK.A4"', 'TAG="AK.A3"', "RECEIVE AK.A3", "each TAG once"),
        ('TAG="Stop"', 'TAG="DiO"', "RECEIVE DiO", "remove it from the file"),
        ('INDX="5" HOLDON="1"', 'INDX="5" HOLDON="0"', "RECEIVE AK.A4 HOLDON", "jump back to the start pose"),
        ('INDX="5" HOLDON="1"', 'INDX="5"', "RECEIVE AK.A4 HOLDON", '"0" or "1"'),
        ('INDX="5" HOLDON', 'INDX="4" HOLDON', "RECEIVE AK.A4 INDX", "no other element"),
        ('INDX="5" HOLDON', 'INDX="INTERNAL" HOLDON', "RECEIVE AK.A4 INDX", "INTERNAL for DEF_"),
        ('TAG="AK.A4" TYPE="DOUBLE"', 'TAG="AK.A4" TYPE="LONG"', "RECEIVE AK.A4 TYPE", "DOUBLE"),
        ('TAG="AK.A4" TYPE="DOUBLE"', 'TAG="AK.A4"', "RECEIVE AK.A4 TYPE", "DOUBLE"),
        ('TAG="Stop" TYPE="BOOL"', 'TAG="Stop" TYPE="DOUBLE"', "RECEIVE Stop TYPE", "BOOL"),
        ('TAG="DEF_AIPos" TYPE="DOUBLE"', 'TAG="DEF_AIPos" TYPE="LONG"', "SEND DEF_AIPos TYPE", "DOUBLE"),
        ('TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"', 'TAG="DEF_AIPos" TYPE="DOUBLE" INDX="1"', "SEND DEF_AIPos INDX",
         "INTERNAL"),
        ('TAG="Stop" TYPE="BOOL" INDX="1"', 'TAG="DEF_Tech.T1" TYPE="DOUBLE" INDX="INTERNAL"', "RECEIVE DEF_Tech.T1",
         "remove it"),
        ('TAG="AK.A4"', 'TAG="AK.A4.x"', "RECEIVE AK.A4.x", "at most one"),
        ('TAG="AK.A4"', 'TAG=""', "RECEIVE ", "a TAG"),
        ("<PORT>49152", "<PORT>70000", "CONFIG/PORT", "1 to 65535"),
        ("<PORT>49152", "<PORT>", "CONFIG/PORT", "with a value"),
        ("<PORT>49152</PORT>", "", "CONFIG/PORT", "with a value"),
        ("<IP_NUMBER>192.168.1.10", "<IP_NUMBER>pc", "CONFIG/IP_NUMBER", "IPv4"),
        ("<SENTYPE>ImFree", "<SENTYPE>Im Free", "CONFIG/SENTYPE", "a letter"),
        ("<ONLYSEND>FALSE", "<ONLYSEND>no", "CONFIG/ONLYSEND", "TRUE or FALSE"),
        ("<CONFIG>", "<CONFIG><PROTOCOL>TCP</PROTOCOL>", "CONFIG/PROTOCOL", "UDP"),
        ("ROOT>", "RSI>", "file", "root element ROOT"),
        ("CONFIG>", "SETUP>", "CONFIG", "one"),
        ("<SEND>", "<XEND>", "file", "well-formed"),
        ("ELEMENTS>", "ITEMS>", "SEND/ELEMENTS", "elements that the controller sends"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_sentence_that_names_the_element(old, new, element, expected):
    error = refusal(changed(old, new))
    assert error.element == element
    assert expected in error.expected


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE ROOT [<!ENTITY a "b">]>' + TEXT,
        '<?xml version="1.0"?><!DOCTYPE ROOT SYSTEM "http://example.com/x.dtd">' + TEXT,
        TEXT + "\0",
        TEXT + " " * MAX_BYTES,
        "",
        "&a;",
    ],
)
def test_hostile_documents_are_refused_before_anything_is_expanded(text):
    assert refusal(text).element == "file"


def test_a_file_that_cannot_be_read_is_refused_by_name(tmp_path):
    binary = tmp_path / "binary.xml"
    binary.write_bytes(b"\xff\xfe<ROOT/>")
    for path in (binary, tmp_path / "none.xml"):
        with pytest.raises(ConfigurationError, match=path.name):
            load_ethernet_xml(path)


@given(st.data())
def test_a_mutated_file_is_read_or_refused_and_never_anything_else(data):
    lines = TEXT.splitlines(keepends=True)
    for _ in range(data.draw(st.integers(1, 3))):
        index = data.draw(st.integers(0, len(lines) - 1))
        action = data.draw(st.sampled_from(["drop", "twice", "cut", "insert"]))
        if action == "insert":
            place = data.draw(st.integers(0, len(lines[index])))
            lines[index] = (
                lines[index][:place] + data.draw(st.text("<>&\"'/ A1=-DEF_\0é", max_size=6)) + lines[index][place:]
            )
        else:
            lines[index] = {"drop": "", "twice": lines[index] * 2, "cut": lines[index][: len(lines[index]) // 2]}[
                action
            ]
    try:
        layout = read_ethernet_xml("".join(lines), "eth.xml").layout
        check_gateway(layout, AXES, "eth.xml")
    except EthernetXmlError as error:
        assert error.element
    else:
        assert {"AIPos", "ASPos"} <= set(layout.send)
        assert layout.onlysend or {f"AK.{axis}" for axis in AXES} <= set(layout.receive)


@pytest.mark.parametrize(
    "axes",
    [
        ("A1", "A2", "A3", "A4"),
        ("E1", "A1", "A2", "A3", "A4", "A5", "A6"),
        ("A1", "A2", "A3", "A4", "A5", "A6", "E1", "E2"),
    ],
)
def test_a_written_file_serves_gateway_and_mock(axes):
    ethernet = read_ethernet_xml(ethernet_xml_text(axes), "written")
    check_gateway(ethernet.layout, axes, "written")
    assert ethernet.layout.receive == ("Stop", *(f"{'EK' if axis[0] == 'E' else 'AK'}.{axis}" for axis in sorted(axes)))
    assert ("EIPos" in ethernet.layout.send) == ("E1" in axes)
    assert ethernet.layout.holdon == (False, *(True for _ in axes))
