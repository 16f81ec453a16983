"""Every shipped scenario on the simulated chain, with the judge and the assertions of `test/integration/test_scenario.py`."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console
from scenario_run import ScenarioRun, shipped

from construction_twin.ros.commands.scenario import print_verdict

ROOT = Path(__file__).resolve().parents[3]
SHIPPED = sorted(path.stem for path in (ROOT / "config/scenarios").glob("*.yaml"))


@pytest.mark.parametrize("name", SHIPPED)
def test_the_cell_does_what_the_scenario_expects(name):
    run = ScenarioRun(name, shipped(name))
    verdict = run.judge()
    failed = [f"{check.name}: {check.found}; expected {check.expected}" for check in verdict.checks if not check.passed]
    assert verdict.passed, "\n".join([*failed, verdict.measured["did"]])
    told = io.StringIO()
    print_verdict(verdict, Console(file=told, width=160))
    assert f"{name}: passed" in told.getvalue()


@pytest.mark.parametrize("name", ["stall_replan", "packets_lost", "encoder_slip", "slow_joint"])
def test_without_its_fault_a_scenario_fails(name):
    content = shipped(name)
    content["scenario"]["steps"] = [step for step in content["scenario"]["steps"] if "inject" not in step]
    content["scenario"]["limit"] = 10.0
    assert not ScenarioRun(name, content).judge().passed


def test_a_scenario_is_the_same_each_time():
    one, other = (ScenarioRun("packets_lost", shipped("packets_lost")).carry_out() for _ in range(2))
    assert one[1] == other[1]
    assert [(change.stamp, change.topic, change.value) for change in one[0].changes] == [
        (change.stamp, change.topic, change.value) for change in other[0].changes
    ]
