"""docs/promises.md: each test that it names exists, each law of the architecture has its rows, and its figures are the code's."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path

import pytest
import yaml

from construction_twin.controller.last_resort import LONGEST_GAP_MS
from construction_twin.core.freshness import LIFETIME
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.segment_run import FIRE_TIMEOUT, LEAD, RECORD_TIMEOUT, SCENE_TIMEOUT
from construction_twin.link.observations import STATUS_TIMEOUT
from construction_twin.robot.executed_path import WAY_BACK_TOLERANCE

ROOT = Path(__file__).resolve().parents[3]
LAWS = {law[0]: law for law in (ROOT / "docs/promises.md").read_text().split("\n## Law ")[1:]}
NAMED = sorted({name for law in LAWS.values() for name in re.findall(r"`((?:unit|integration|browser)/[^`]+)`", law)})


def nameable(file: Path) -> set[str]:
    """Return what can be named in a file of tests: functions, classes that hold some, and their methods."""
    names = set()
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            inside = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
            methods = {f"{node.name}::{name}" for name in inside if name.startswith("test_")}
            names |= methods | ({node.name} if methods else set())
    return names


@pytest.mark.parametrize("name", NAMED)
def test_a_test_that_keeps_a_law_exists(name):
    path, _, inside = name.partition("::")
    assert inside in nameable(ROOT / "test" / path), f"{path} has no {inside}"


def test_every_law_of_the_architecture_has_its_rows():
    laws = (ROOT / "docs/architecture.md").read_text().split("\n## Laws\n")[1]
    assert sorted(LAWS) == re.findall(r"^(\d)\. \*\*", laws, re.MULTILINE) == list("12345678")
    assert all(re.search(r"^\| .+ \| `(unit|integration)/", law, re.MULTILINE) for law in LAWS.values())


@pytest.mark.parametrize(
    "value, expected",
    [
        (LONGEST_GAP_MS, 40),
        (LIFETIME, 3 * NANOSECONDS),
        (LEAD, 0.15 * NANOSECONDS),
        (FIRE_TIMEOUT, 3 * NANOSECONDS),
        (SCENE_TIMEOUT, 30 * NANOSECONDS),
        (RECORD_TIMEOUT, 10 * NANOSECONDS),
        (WAY_BACK_TOLERANCE, 2e-4),
        (STATUS_TIMEOUT, 3 * NANOSECONDS),
        (math.degrees(yaml.safe_load((ROOT / "config/gateway.yaml").read_text())["start_tolerance"]), 0.05),
    ],
)
def test_figures_of_the_laws_are_those_of_the_architecture(value, expected):
    """Tests that take a figure from the code keep a law whatever the figure is; setpoints lie on a grid of 4 ms."""
    assert value == pytest.approx(expected, rel=0.015)
