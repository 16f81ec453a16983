"""A node is declared once: what its process starts with is what `preflight` checks before anything starts."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

import pydantic
import pytest
import rospy
from chain_samples import ROBOT

from construction_twin.core.errors import ConfigurationError
from construction_twin.ros import nodes
from construction_twin.ros.commands.node_files import NODE_FILES
from construction_twin.ros.shared import node as module
from construction_twin.ros.shared.node import NodeShell

ROOT = Path(__file__).resolve().parents[3]


def shells() -> dict[str, NodeShell]:
    modules = (
        importlib.import_module(f"{nodes.__name__}.{found.name}") for found in pkgutil.iter_modules(nodes.__path__)
    )
    return {each.NODE.name: each.NODE for each in modules if hasattr(each, "NODE")}


class Settings(pydantic.BaseModel):
    rate: float


def refuse_fast(settings: Settings, robot) -> None:
    if settings.rate > 10.0:
        raise ConfigurationError("rate", settings.rate, f"at most 10 for {robot.name}")


def started(monkeypatch, values: dict) -> list:
    """Run the node with private parameters; return what it was started with."""
    found = []
    shell = NodeShell("fast", Settings, lambda settings, robot: found.append((settings.rate, robot)), refuse_fast)
    monkeypatch.setattr(rospy, "get_param", lambda name, default=None: values)
    monkeypatch.setattr(rospy, "get_name", lambda: "/kr120/fast")
    monkeypatch.setattr(module, "robot_from_parameters", lambda: ROBOT)
    monkeypatch.setattr(module, "run_node", lambda name, start: start())
    shell.run()
    return found


def test_a_node_starts_with_parameters_and_robot(monkeypatch):
    assert started(monkeypatch, {"rate": 5.0}) == [(5.0, ROBOT)]


@pytest.mark.parametrize("values, says", [({"rate": 50.0}, "at most 10 for kr120"), ({}, "rate")])
def test_what_preflight_refuses_the_node_refuses_in_the_same_words(monkeypatch, values, says):
    with pytest.raises(ConfigurationError, match=says) as caught:
        NodeShell("fast", Settings, lambda *_: None, refuse_fast).check_values(values, ROBOT)
    with pytest.raises(ConfigurationError) as ended:
        started(monkeypatch, values)
    assert str(ended.value).endswith(str(caught.value))


def test_every_node_with_a_file_in_config_is_checked_by_preflight():
    # scene.yaml holds objects, and no parameters
    files = {path.stem for path in (ROOT / "config").glob("*.yaml")} - {"scene"}
    checked = {file.name for file in NODE_FILES}
    assert {name for name in shells() if name in files} <= checked


def test_every_node_runs_its_shell():
    programs = {path.name for path in (ROOT / "nodes").iterdir() if path.is_file()}
    for name, shell in shells().items():
        assert name in programs and issubclass(shell.settings, pydantic.BaseModel)
