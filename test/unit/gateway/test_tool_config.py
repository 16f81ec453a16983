"""The tool in the gateway's configuration: what it must agree with."""

from __future__ import annotations

import dataclasses

import pytest
import yaml
from processes import ROOT
from tool_cell import LAYOUT, TOOL, ToolCell, switched_off_on_stop

from construction_twin.controller.port import ToolOutput
from construction_twin.gateway.config import parse_config
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.rsi.ethernet_xml import EthernetXmlError
from construction_twin.rsi.make import check_tool

FILE = yaml.safe_load((ROOT / "config/tools/vacuum_frame.yaml").read_text())
XML = {name: (ROOT / f"krl/ethernet/{name}_ethernet.xml").read_text() for name in ("ctwin", "ctwin_tool")}


@pytest.fixture(scope="module")
def robot():
    return read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")


def test_it_comes_from_the_tool_file_and_is_part_of_the_hash(robot):
    config = gateway_config(robot, {"ethernet_xml": XML["ctwin_tool"], "tool": FILE})
    assert config.tool == TOOL
    other = gateway_config(robot, {"ethernet_xml": XML["ctwin_tool"], "tool": FILE | {"name": "another"}})
    assert other.hash != config.hash
    assert parse_config(config.to_json(), "file") == config


def test_a_tool_file_without_channels_is_a_tool_without_hands(robot):
    assert gateway_config(robot, {"ethernet_xml": XML["ctwin"], "tool": FILE}).tool is None
    assert gateway_config(robot, {"ethernet_xml": XML["ctwin"], "tool": {}}).tool is None


def test_channels_without_a_tool_file_are_refused(robot):
    with pytest.raises(EthernetXmlError, match="found 'no tool'.*launch argument tool"):
        gateway_config(robot, {"ethernet_xml": XML["ctwin_tool"]})


@pytest.mark.parametrize(
    "tool, sentence",
    [
        (dataclasses.replace(TOOL, outputs=(ToolOutput("clamp", "keep"),)), "RECEIVE Set.clamp"),
        (dataclasses.replace(TOOL, outputs=(*TOOL.outputs, ToolOutput("lamp", "off"))), "RECEIVE Set.lamp"),
        (dataclasses.replace(TOOL, inputs=("vacuum_reached", "part")), "SEND In.part"),
        (dataclasses.replace(TOOL, inputs=("part",)), "SEND In.part"),
        (switched_off_on_stop()[1], "Set.vacuum HOLDON: found '1', expected \"0\".*on_stop: off"),
    ],
)
def test_a_mismatch_is_refused_in_one_sentence(tool, sentence):
    with pytest.raises(EthernetXmlError, match=sentence) as refused:
        check_tool(tool, LAYOUT, "file.xml")
    assert str(refused.value).count("\n") == 0
    with pytest.raises(EthernetXmlError):
        ToolCell(tool=tool)


def test_the_shipped_pair_fits_and_a_read_only_context_needs_no_set_channels():
    check_tool(TOOL, LAYOUT, "file")
    check_tool(
        TOOL, dataclasses.replace(LAYOUT, onlysend=True, receive=(), holdon=(), switched=(), switched_holdon=()), "f"
    )
