"""What a person is told of a wrong document: key, value and what is allowed, for every error that our models can raise."""

from __future__ import annotations

import importlib
import math
import pkgutil
import re
from pathlib import Path

import pydantic
import pytest
import yaml

import construction_twin
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import PATTERNS, configuration_error, wrong_value
from construction_twin.monitor.settings import Behaviour
from construction_twin.robot.description import load_robot
from construction_twin.robot.urdf import expand_xacro
from construction_twin.scenario.definition import make_scenario

ROOT = Path(__file__).resolve().parents[3]
#: What pydantic says, and what people should not have to read.
FOREIGN = re.compile(
    r"Input should|Field required|should (be|match|have)|Extra inputs|Value error|valid (dict|integer|string|number|list)"
)
BAD = (
    None, "", "no such thing", "-1", -1, 0, 1, 1.5, -1e12, 1e12, math.nan, math.inf, True, [], {}, [None], ["", ""], [1.0] * 20,
    {"": None}, {"no such key": 1.0}, {"joint_a1": "fast"}, [{"when": "never", "no such key": 1}], [{}], {"sync": 3},
)  # fmt: skip


def models() -> list[type[pydantic.BaseModel]]:
    """Return every model of the package."""
    found = {}
    for module in pkgutil.walk_packages(construction_twin.__path__, "construction_twin."):
        if ".msg" in module.name or ".srv" in module.name or module.name.endswith("__main__"):
            continue
        for value in vars(importlib.import_module(module.name)).values():
            if (
                isinstance(value, type)
                and issubclass(value, pydantic.BaseModel)
                and value.__module__.startswith("construction_twin")
            ):
                found[f"{value.__module__}.{value.__name__}"] = value
    return [model for model in found.values() if model.model_fields]


class Single:
    """One of the errors that pydantic found."""

    def __init__(self, problem):
        self._problem = problem

    def errors(self):
        return [self._problem]


def problems(model: type[pydantic.BaseModel]) -> list[dict]:
    """Return what pydantic finds wrong with many documents."""
    found = []
    for name in model.model_fields:
        for bad in BAD:
            try:
                model.model_validate({name: bad, "no such key at all": 1})
            except pydantic.ValidationError as error:
                found += error.errors()
    for bad in BAD:
        try:
            model.model_validate(bad)
        except pydantic.ValidationError as error:
            found += error.errors()
    return found


@pytest.mark.parametrize("model", models(), ids=lambda model: f"{model.__module__.rpartition('.')[2]}.{model.__name__}")
def test_no_word_of_pydantic_reaches_a_person(model):
    schema = model.model_json_schema()
    found = problems(model)
    assert found
    for problem in found:
        wrong = wrong_value(Single(problem), schema)
        told = f"{wrong.key}: found {wrong.value!r}, expected {wrong.expected}"
        assert wrong.expected and "another value" not in wrong.expected, (told, problem)
        assert not FOREIGN.search(wrong.expected) and problem["msg"] not in told, (told, problem)


def test_every_kind_of_error_was_tried():
    kinds = {problem["type"] for model in models() for problem in problems(model)}
    assert {
        "missing", "extra_forbidden", "finite_number", "float_type", "float_parsing", "int_type", "int_parsing", "int_from_float",
        "bool_type", "bool_parsing", "string_type", "string_pattern_mismatch", "string_too_short", "literal_error", "list_type",
        "dict_type", "tuple_type", "too_short", "greater_than", "greater_than_equal", "less_than", "less_than_equal", "model_type",
    } <= kinds  # fmt: skip


def patterns(node: object) -> set[str]:
    """Return the patterns in a JSON Schema."""
    if isinstance(node, dict):
        own = {node["pattern"]} if isinstance(node.get("pattern"), str) else set()
        return own.union(*map(patterns, node.values()))
    return set().union(*map(patterns, node)) if isinstance(node, list) else set()


def test_every_pattern_is_told_in_words():
    assert set().union(*(patterns(model.model_json_schema()) for model in models())) == set(PATTERNS)


ARM = yaml.safe_load((ROOT / "config/kr120.yaml").read_text())
URDF = expand_xacro(ROOT / "urdf/kr120r2500.urdf.xacro")


def without(key: str) -> dict:
    return {name: value for name, value in ARM.items() if name != key}


@pytest.mark.parametrize(
    "description, sentence",
    [
        (without("tip_link"), "robot/tip_link: found nothing, expected a text"),
        (
            ARM | {"name": "KR 120"},
            "robot/name: found 'KR 120', expected a name of small letters, digits and _ that begins with a letter",
        ),
        (ARM | {"tipp_link": "tool0"}, "robot/tipp_link: found 'tool0', expected no such key; did you mean tip_link?"),
        (ARM | {"joints": 3}, "robot/joints: found 3, expected a mapping, each value a mapping"),
        (
            ARM | {"joints": ARM["joints"] | {"joint_a1": ARM["joints"]["joint_a1"] | {"rsi": "B1"}}},
            "robot/joints/joint_a1/rsi: found 'B1', expected A1 to A6 or E1 to E6",
        ),
        (
            ARM | {"joints": ARM["joints"] | {"joint_a2": ARM["joints"]["joint_a2"] | {"jerk_deg_s3": 0, "sign": 2}}},
            "robot/joints/joint_a2/sign: found 2, expected 1 or -1 (2 keys are wrong)",
        ),
        (
            ARM | {"joints": ARM["joints"] | {"joint_a2": ARM["joints"]["joint_a2"] | {"home_deg": math.inf}}},
            "robot/joints/joint_a2/home_deg: found inf, expected a finite number",
        ),
    ],
)
def test_a_robot_yaml_is_told_by_key_value_and_what_is_allowed(description, sentence):
    with pytest.raises(ConfigurationError) as error:
        load_robot(URDF, description)
    assert str(error.value) == sentence


def test_settings_at_run_time_and_nested_documents_likewise():
    behaviour = Behaviour.model_validate(
        {
            key: value
            for key, value in yaml.safe_load((ROOT / "config/pca_monitor.yaml").read_text()).items()
            if key != "sync_rate"
        }
    )
    for text, sentence in (
        ("{policy: replann}", "policy: found 'replann', expected replan, resume or stop"),
        ("{threshold: 2}", "threshold: found 2, expected a number above 0 and at most 1"),
        (
            "{thresholds: {joint_a3: high}}",
            "thresholds/joint_a3: found 'high', expected a number above 0 and at most 1",
        ),
        ("{treshold: 0.1}", "treshold: found 0.1, expected no such key; did you mean threshold?"),
    ):
        with pytest.raises(ConfigurationError) as error:
            behaviour.changed(text)
        assert str(error.value) == sentence
    with pytest.raises(
        Exception, match=r"^x: steps/0/move/goal_deg/1: found 'far', expected a number \(\d keys are wrong\)$"
    ):
        make_scenario("x", {"title": "t", "steps": [{"move": {"goal_deg": [1.0, "far"]}}]})


def test_the_place_in_a_file_stands_before_the_key():
    class Document(pydantic.BaseModel):
        pair: tuple[int, str] | None

    with pytest.raises(pydantic.ValidationError) as error:
        Document.model_validate({"pair": [1.5, "a"]})
    said = configuration_error(error.value, Document, "/etc/pair.yaml")
    assert said.where == "/etc/pair.yaml/pair/0" and said.value == 1.5 and said.expected == "a whole number"
