"""Scenario files: read as a whole, refused with one sentence; those that are shipped."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from mock_cell import Cell

from construction_twin.core.units import from_wire
from construction_twin.mock.faults import KINDS, Fault, FaultBoard
from construction_twin.robot.description import read_robot_files
from construction_twin.scenario.definition import Scenario, ScenarioError, make_scenario

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted((ROOT / "config/scenarios").glob("*.yaml"))
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
MOVE = {"move": {"goal_deg": [0, -90, 90, 0, 90, 0]}}
EXPECT = {"sync": ["IN_SYNC"], "final": {"sync": "IN_SYNC"}, "ends": "goal"}


def read_scenario(path: Path) -> Scenario:
    return make_scenario(path.stem, yaml.safe_load(path.read_text())["scenario"])


def scenario(**changes):
    return make_scenario("test", {"title": "a test", "steps": [MOVE], "expect": EXPECT} | changes)


@pytest.mark.parametrize(
    "changes, place",
    [
        ({"title": ""}, "title"),
        ({"steps": []}, "steps"),
        ({"steps": [{"when": "now"}]}, "steps/0"),
        ({"steps": [MOVE | {"call": "stop"}]}, "steps/0"),
        ({"steps": [{"call": "shutdown"}]}, "steps/0/call"),
        ({"steps": [{"when": "later", "call": "stop"}]}, "steps/0/when"),
        ({"steps": [{"after": -1.0, "call": "stop"}]}, "steps/0/after"),
        ({"steps": [{"inject": {"fault": "melt"}}]}, "steps/0/inject/fault"),
        ({"steps": [{"inject": {"fault": "estop", True: False}}]}, "steps/0/inject"),
        ({"expect": EXPECT | {"ends": "anywhere"}}, "expect/ends"),
        ({"expect": EXPECT | {"final": {"weather": "fine"}}}, "expect/final"),
        ({"expect": EXPECT | {"max_error": 1.0}}, "expect/max_error"),
        ({"limit": 0.0}, "limit"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_place(changes, place):
    with pytest.raises(ScenarioError, match=f"^test: {place}"):
        scenario(**changes)


@pytest.mark.parametrize("content", [3, ["steps"], None, ""])
def test_what_holds_no_keys_is_refused(content):
    with pytest.raises(ScenarioError, match="^broken: "):
        make_scenario("broken", content)


def test_faulted_joints_are_those_that_do_not_do_what_they_are_told():
    def inject(**fault):
        return {"inject": fault}

    stall = inject(fault="stall", joint="joint_a3")
    assert scenario(steps=[MOVE, stall, inject(fault="noise", value=[1e-4])]).faulted == {"joint_a3"}
    assert scenario(steps=[inject(fault="estop")]).faulted == frozenset()
    assert scenario(steps=[stall, inject(fault="drop", value=[0.1])]).faulted == {"joint_a3"}


def test_at_least_ten_are_shipped_and_those_that_run_live_are_among_them():
    """Every one is run in unit/chain/test_scenarios.py."""
    assert len(FILES) >= 10
    live = [path.stem.removeprefix("scenario_") for path in (ROOT / "test/integration").glob("scenario_*.test")]
    assert live and set(live) <= {path.stem for path in FILES}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_shipped_scenarios_are_valid_fit_the_robot_and_are_documented(path):
    found = read_scenario(path)
    assert found.name == path.stem
    assert path.read_text().startswith("# ")
    assert f"`{path.stem}`" in (ROOT / "docs/scenarios.md").read_text()
    for step in found.steps:
        if step.move:
            ROBOT.check_range(from_wire(step.move.goal_deg, ROBOT.linear))
        if step.inject and not step.inject.end:
            assert step.inject.joint in ("", *ROBOT.joint_names)
            axis = ROBOT.axes[ROBOT.joint_names.index(step.inject.joint)].name if step.inject.joint else ""
            fault = Fault(
                step.inject.fault, axis, tuple(step.inject.values), step.inject.direction, step.inject.duration
            )
            FaultBoard(Cell().mock, 0).inject(fault)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_shipped_scenarios_change_only_parameters_that_there_are(path):
    for node, values in yaml.safe_load(path.read_text()).items():
        if node == "scenario":
            continue
        if node == "executor":
            assert set(values) <= {"auto_approve", "rehearsal"}
            continue
        known = yaml.safe_load((ROOT / f"config/{node}.yaml").read_text())
        # given in the launch files, and so in no file of config/
        launched = {"mode", "payload"}
        assert set(values) <= set(known) | launched, node


def test_every_fault_is_in_a_scenario_or_is_motion_of_its_own_or_a_mere_word():
    """Those of the gripper are played with gateway and executor in chain/test_tool_chain.py: a scenario has no tool."""
    used = {step.inject.fault for path in FILES for step in read_scenario(path).steps if step.inject}
    assert used == set(KINDS) - {
        "jog",
        "mode",
        "program",
        "override",
        "grip_fails",
        # which needs an arm with mass: test/unit/chain/test_servo_chain.py
        "collision",
        "grip_lost",
        "opened_by_hand",
        "no_read_back",
    }
