"""krl/: what a user copies to the controller agrees with itself, with docs/rsi.md and with what gateway and mock read."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import make_krl  # noqa: E402
import pytest
from processes import ROOT

from construction_twin.rsi.ethernet_xml import check_gateway, load_ethernet_xml

KRL = ROOT / "krl"
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
TOOLS = ("ctwin_tool", "ctwin_e1_tool")
MOVING = ("ctwin", "ctwin_e1", *TOOLS)
NAMES = (*MOVING, "ctwin_ro")
FILES = sorted(path for path in KRL.rglob("*") if path.is_file() and path.suffix != ".md")
#: Objects of RSI 4.1 by their name in RSI 3.
PAIRS = {
    "ETHERNET": "Ethernet",
    "AXISCORR": "AxisCorr",
    "AXISCORREXT": "AxisCorrExt",
    "AXISCORRMON": "AxisCorrMon",
    "STOP": "Stop",
}


def layout(name):
    return load_ethernet_xml(KRL / "ethernet" / f"{name}_ethernet.xml").layout


def rsi3(name):
    """Return the objects of an RSI 3 context by type."""
    root = ElementTree.parse(KRL / "rsi3" / "SensorInterface" / f"{name}.rsi.xml").getroot()
    return {item.get("ObjType"): item for item in root}


def rsi41(name):
    root = ElementTree.parse(KRL / "rsi41" / "SensorInterface" / f"{name}.rsix").getroot()
    return {item.get("ObjType"): item for item in root.iter("{RsiDriver}RsiObject")}


def inputs(item):
    """Return (own input, output of ETHERNET) of an object."""
    return [(int(i.get("InIdx")), int(i.get("OutIdx"))) for i in item.iter() if i.tag.endswith("Input")]


def parameters(item, key="ParamValue"):
    return {p.get("Name"): p.get(key) for p in item.iter() if p.tag.endswith("Parameter")}


def program(name, generation):
    return (KRL / generation / "Program" / f"{name}.src").read_text()


def test_the_files_are_those_of_the_generator():
    expected = {KRL / name: text for name, text in make_krl.files()}
    assert sorted(expected) == FILES
    for path, text in expected.items():
        assert path.read_text() == text, f"{path}: run tools/make_krl.py"


@pytest.mark.parametrize("name, axes", [(name, (*AXES, "E1") if "_e1" in name else AXES) for name in NAMES])
def test_the_gateway_accepts_the_ethernet_files(name, axes):
    check_gateway(layout(name), axes, name)
    assert "<!DOCTYPE" not in (KRL / "ethernet" / f"{name}_ethernet.xml").read_text()
    assert not any(channel.startswith("DEF_Tech") for channel in layout(name).receive)


@pytest.mark.parametrize("name", MOVING)
def test_corrections_hold_and_stop_does_not(name):
    holdon = dict(zip(layout(name).receive, layout(name).holdon))
    assert holdon.pop("Stop") is False
    assert all(holdon.values()) and len(holdon) >= 6


@pytest.mark.parametrize("name", MOVING)
@pytest.mark.parametrize("read, first, kinds", [(rsi3, 1, {k: k for k in PAIRS}), (rsi41, 0, PAIRS)])
def test_every_channel_of_the_ethernet_file_is_wired_to_its_own_input(name, read, first, kinds):
    root = ElementTree.parse(KRL / "ethernet" / f"{name}_ethernet.xml").getroot()
    index = {e.get("TAG"): int(e.get("INDX")) for e in root.find("RECEIVE/ELEMENTS")}
    context = read(name)
    assert inputs(context[kinds["STOP"]]) == [(first, index["Stop"] - 1 + first)]
    assert inputs(context[kinds["AXISCORR"]]) == [(k + first, index[f"AK.A{k + 1}"] - 1 + first) for k in range(6)]
    external = kinds["AXISCORREXT"]
    assert (external in context) == ("EK.E1" in index)
    if external in context:
        # RSI 3 counts E1 after A6, RSI 4.1 has an object of its own for it
        assert inputs(context[external]) == [(7 if first else 0, index["EK.E1"] - 1 + first)]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("read, kinds", [(rsi3, {k: k for k in PAIRS}), (rsi41, PAIRS)])
def test_contexts_name_their_ethernet_file_and_have_the_recommended_values(name, read, kinds):
    context = read(name)
    ethernet = parameters(context[kinds["ETHERNET"]])
    assert ethernet == {"ConfigFile": f"{name}_ethernet.xml", "Timeout": "100", "Flag": "1", "Precision": "6"}
    assert (KRL / "ethernet" / ethernet["ConfigFile"]).is_file()
    if name == "ctwin_ro":
        assert set(context) == {kinds["ETHERNET"]}
        return
    assert parameters(context[kinds["STOP"]])["Mode"] == "4"
    assert parameters(context[kinds["AXISCORRMON"]]).keys() == {f"Max{a}{i}" for a in "AE" for i in range(1, 7)}


@pytest.mark.parametrize("name", MOVING)
@pytest.mark.parametrize("read, kinds", [(rsi3, {k: k for k in PAIRS}), (rsi41, PAIRS)])
def test_bounds_are_wide_enough_for_any_start_pose_and_supervised(name, read, kinds):
    from construction_twin.robot.description import read_robot_files

    robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
    bounds = parameters(read(name)[kinds["AXISCORR"]])
    monitor = parameters(read(name)[kinds["AXISCORRMON"]])
    for axis, lower, upper in zip(AXES, robot.lower, robot.upper):
        span = (upper - lower) * 57.29577951308232
        assert float(bounds[f"UpperLim{axis}"]) >= span - 1e-9
        assert float(bounds[f"LowerLim{axis}"]) <= -span + 1e-9
        assert float(monitor[f"Max{axis}"]) >= span - 1e-9


@pytest.mark.parametrize("generation, suffix", [("rsi3", ".rsi"), ("rsi41", "")])
@pytest.mark.parametrize("name", NAMES)
def test_programs_name_the_right_context_and_use_absolute_corrections_only(name, generation, suffix):
    code = "\n".join(line.split(";")[0] for line in program(name, generation).splitlines())
    assert re.search(rf"^DEF {name}\(\)$", code, re.MULTILINE)
    assert re.findall(r'RSI_CREATE\("([^"]+)"', code) == [name + suffix]
    files = KRL / generation / "SensorInterface"
    assert (files / (f"{name}.rsi.xml" if suffix else f"{name}.rsix")).is_file()
    assert re.findall(r"RSI_ON\((.*)\)", code) == ["#ABSOLUTE, #IPO_FAST"]
    assert "#RELATIVE" not in code
    assert ("RSI_MOVECORR()" in code) == (name in MOVING)
    order = [
        "PTP $AXIS_ACT_MEAS",
        "RSI_CREATE",
        "RSI_ON",
        *(["RSI_MOVECORR"] if name in MOVING else []),
        "RSI_OFF",
        "RSI_DELETE",
    ]
    places = [code.index(word) for word in order]
    assert places == sorted(places)


@pytest.mark.parametrize("name", MOVING)
def test_the_program_for_rsi_4_1_sets_public_parameters_that_exist_from_the_soft_limits(name):
    calls = re.findall(r'RSI_SetPublicPar\(container, "(\w+)_1", "(\w+)", (\w+)\)', program(name, "rsi41"))
    context = rsi41(name)
    for kind, parameter, value in calls:
        public = {p.get("Name") for p in context[kind].iter() if p.get("IsPublic") == "true"}
        assert parameter in public
        assert value == {"Low": "below", "Upp": "above", "Max": "most"}[parameter[:3]]
    axes = (*AXES, "E1") if "_e1" in name else AXES
    assert [p for _, p, _ in calls] == [f"{word}{axis}" for axis in axes for word in ("LowerLim", "UpperLim", "Max")]
    assert program(name, "rsi3").count("RSI_SetPublicPar") == 0
