"""The simulated gripper: how long it takes, what its faults do, and that a mock without a tool has none."""

from __future__ import annotations

import pytest
from mock_cell import Cell
from processes import ROOT
from sentence_checks import says
from tool_cell import GRIPPER, LAYOUT

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.mock.faults import Fault, FaultBoard
from construction_twin.mock.gripper import SimulatedTool
from construction_twin.mock.program import build_controller, checked_settings, parse_arguments
from construction_twin.robot.description import read_robot_files

FILES = ["--ethernet-xml", str(ROOT / "krl/ethernet/ctwin_tool_ethernet.xml"), "--gateway", "127.0.0.1:5"]
FRAME = str(ROOT / "config/tools/vacuum_frame.yaml")


def tool():
    return SimulatedTool(LAYOUT, GRIPPER, 0.004)


def steps(gripper, count):
    for _ in range(count):
        gripper.step()
    return gripper.inputs["vacuum_reached"]


def test_the_input_follows_after_the_time_that_was_set():
    gripper = tool()
    gripper.take((True, True))
    assert not steps(gripper, 49) and steps(gripper, 1) and gripper.holds
    gripper.take((True, False))
    assert steps(gripper, 49) and not steps(gripper, 1)


def test_a_grip_that_is_opened_before_it_has_closed_never_confirms():
    gripper = tool()
    gripper.take((True, True))
    steps(gripper, 30)
    gripper.take((True, False))
    assert not any(steps(gripper, 1) for _ in range(200))


def test_inputs_begin_as_an_open_gripper_and_go_on_while_rsi_is_off():
    gripper = tool()
    assert gripper.inputs == {"vacuum_reached": False}
    gripper.take((True, True))
    gripper.begin_session()
    assert steps(gripper, 60) and gripper.outputs == {"vacuum": True}


def test_a_mock_without_a_tool_has_no_gripper_to_fail():
    cell = Cell()
    assert cell.mock.tool is None
    for name in ("grip_fails", "grip_lost", "opened_by_hand", "no_read_back"):
        with pytest.raises(ConstructionTwinError, check=says("reason.no_tool_channels", fault=name)):
            FaultBoard(cell.mock, 0).inject(Fault(name))


def test_the_program_takes_a_tool_file():
    robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
    for options, closes in ((["--tool", FRAME], True), ([], False)):
        given = vars(parse_arguments([*FILES, *options]))
        for name in ("robot_xacro", "robot_config"):
            del given[name]
        gripper = build_controller(checked_settings(given), robot).tool
        gripper.take((True, True))
        assert steps(gripper, 60) is closes


def test_what_is_no_tool_file_is_refused(tmp_path):
    (tmp_path / "tool.yaml").write_text("name: Frame")
    with pytest.raises(ConfigurationError, match="tool.yaml"):
        checked_settings(vars(parse_arguments([*FILES, "--tool", str(tmp_path / "tool.yaml")])))
