"""Channels of a tool: what an Ethernet XML may declare, and both directions of the codec."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import ROOT

from construction_twin.controller.port import ToolReading
from construction_twin.core.errors import ConfigurationError, TelegramError
from construction_twin.rsi.controller_codec import RobotEncoder, SensorDecoder
from construction_twin.rsi.ethernet_xml import (
    EthernetXmlError,
    check_gateway,
    load_ethernet_xml,
    read_ethernet_xml,
    tool_channels,
)
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder
from construction_twin.rsi.layout import RsiLayout, ToolReader

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
ZERO = (0.0,) * 6
TEXT = (ROOT / "krl/ethernet/ctwin_tool_ethernet.xml").read_text()
SEND = ("RIst", "RSol", "AIPos", "ASPos", "Delay", "Out.vacuum", "Out.lamp", "In.reached")
SWITCHED = ("Enable", "vacuum", "lamp")


def layout_of(text):
    layout = read_ethernet_xml(text, "file").layout
    check_gateway(layout, AXES, "file")
    return layout


def packet(signals, send=SEND):
    return RobotEncoder(AXES, 6, send).encode(4711, ZERO, ZERO, ZERO, ZERO, 0, signals=signals)


def reader():
    return ToolReader(("vacuum", "lamp"), ("reached",))


# -- the Ethernet XML


def test_the_shipped_file_declares_the_tool_and_changes_nothing_else():
    layout = layout_of(TEXT)
    assert (layout.switched, layout.switched_holdon) == (("Enable", "vacuum"), (True, True))
    assert tool_channels(layout) == ("Set.Enable", "Set.vacuum", "Out.vacuum", "In.vacuum_reached")
    plain = load_ethernet_xml(ROOT / "krl/ethernet/ctwin_ethernet.xml").layout
    send = tuple(tag for tag in layout.send if "." not in tag)
    assert dataclasses.replace(layout, switched=(), switched_holdon=(), send=send) == plain
    assert tool_channels(plain) == ()


@pytest.mark.parametrize(
    "old, new, sentence",
    [
        ('TAG="Set.Enable" TYPE="BOOL" INDX="8" HOLDON="1"', 'TAG="Set.Enable" TYPE="BOOL" INDX="8" HOLDON="0"', "Set.Enable"),
        ('      <ELEMENT TAG="Set.Enable" TYPE="BOOL" INDX="8" HOLDON="1"/>\n', "", "without it RSI_ON itself may open a grip"),
        ('      <ELEMENT TAG="Out.vacuum" TYPE="BOOL" INDX="1"/>\n', "", "what is not read back is not switched"),
        ('TAG="Set.vacuum" TYPE="BOOL"', 'TAG="Set.vacuum" TYPE="LONG"', "BOOL"),
        ('TAG="Set.vacuum"', 'TAG="Set.Vacuum"', "no other channel is filled"),
        ('TAG="Set.vacuum"', 'TAG="Set"', "no other channel is filled"),
    ],
)  # fmt: skip
def test_what_could_switch_an_output_unseen_is_refused(old, new, sentence):
    assert old in TEXT
    with pytest.raises(EthernetXmlError, match=sentence):
        layout_of(TEXT.replace(old, new))


# -- what a controller tells


@given(st.booleans(), st.booleans(), st.booleans())
def test_what_is_sent_is_read(vacuum, lamp, reached):
    data = packet({"Out.vacuum": vacuum, "Out.lamp": lamp, "In.reached": reached})
    assert reader().read(data) == ToolReading((vacuum, lamp), (reached,))
    assert data.count(b"<Out ") == 1 and RobotDecoder(AXES).parse(data).controller_ms == 4711


@pytest.mark.parametrize(
    "text, reading",
    [
        (b'<Rob><Out vacuum="1" lamp="0"/><In reached="1"/></Rob>', ToolReading((True, False), (True,))),
        (b"<Rob><In reached='1' /><Out\n lamp='0'\tvacuum = '1' more='x'/></Rob>", ToolReading((True, False), (True,))),
        (b'<Rob><Out vacuum="1"/><In reached="1"/></Rob>', None),
        (b'<Rob><Out vacuum="1" lamp="0"/></Rob>', None),
        (b'<Rob><Out vacuum="1" lamp="2"/><In reached="1"/></Rob>', None),
        (b'<Rob><Out vacuum="1" lamp="true"/><In reached="1"/></Rob>', None),
        (b'<Rob><Out vacuum="1" lamp=""/><In reached="1"/></Rob>', None),
        (b'<Rob><Out vacuum="1" lamp="0" vacuum="0"/><In reached="1"/></Rob>', None),
        (b'<Rob><Out vacuum="1" lamp="0"/><Out vacuum="0" lamp="0"/><In reached="1"/></Rob>', None),
        (b"", None),
    ],
)
def test_what_is_not_told_clearly_is_not_known(text, reading):
    assert reader().read(text) == reading


# -- what the gateway sends


@given(st.tuples(st.booleans(), st.booleans(), st.booleans()), st.sampled_from([None, False, True]))
def test_what_is_switched_arrives(switched, stop):
    receive = ("Stop", *RsiLayout.plain(AXES).receive)
    encoder = SensorEncoder("ImFree", AXES, receive, (), SWITCHED)
    telegram = SensorDecoder("ImFree", AXES, receive, (), SWITCHED).parse(encoder.encode(ZERO, 4711, stop, switched))
    assert (telegram.controller_ms, telegram.switched, telegram.stop) == (4711, switched, bool(stop))
    assert telegram.target == ZERO


def test_without_values_every_channel_is_0():
    encoder = SensorEncoder("ImFree", AXES, (), (), SWITCHED)
    assert b'<Set Enable="0" vacuum="0" lamp="0"/>' in encoder.encode(ZERO, 1)
    with pytest.raises(ConfigurationError, match="a value for each of Enable, vacuum, lamp"):
        encoder.encode(ZERO, 1, None, (True,))


@pytest.mark.parametrize(
    "old, new, reason",
    [
        (b'<Set Enable="1" vacuum="1" lamp="0"/>', b"", "element"),
        (b' lamp="0"', b"", "attribute"),
        (b'lamp="0"', b'lamp="true"', "number"),
    ],
)
def test_a_reply_that_lacks_a_channel_does_not_count(old, new, reason):
    data = SensorEncoder("ImFree", AXES, (), (), SWITCHED).encode(ZERO, 1, None, (True, True, False))
    assert old in data
    with pytest.raises(TelegramError) as refused:
        SensorDecoder("ImFree", AXES, switched=SWITCHED).parse(data.replace(old, new))
    assert refused.value.reason == reason
