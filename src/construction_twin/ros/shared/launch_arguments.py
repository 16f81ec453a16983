"""What the launch files make of their arguments: what they load and give beside a node's own file in config/."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from construction_twin.controller.makes import DEFAULT
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.robot.urdf import read_text
from construction_twin.views.preflight import NONE

#: Arguments of a launch, by name; those that are not given have their defaults.
Given = Mapping[str, str]
#: Parameters, by key.
Values = dict[str, Any]

#: Of the broker, for a check: any address will do.
BROKER = {"host": "127.0.0.1", "port": 18830}


def arm_of(given: Given) -> str:
    """Return which physical arm there is: mock, real or none."""
    return given.get("arm", "mock")


def has_link(given: Given) -> bool:
    """Return whether there is a physical arm, and so a link to it."""
    return arm_of(given) != "none"


def decimals_of(given: Given) -> int:
    """Return the decimals of a degree on the wire."""
    return int(given.get("decimals", "3"))


def payload_of_launch(text: str) -> list[float]:
    """Return the numbers of a launch argument that says a payload, ``KG`` or ``KG,X,Y,Z``; [] for none.

    Raises:
        ConfigurationError: If it is neither.
    """
    try:
        return [float(part) for part in text.split(",")] if text else []
    except ValueError as error:
        raise ConfigurationError("payload", text, Sentence("expected.physics.payload")) from error


def tool_settings(given: Given) -> Values:
    """Return what launch/link.launch loads of a tool file; nothing without one."""
    return {"tool": read_mapping(given["tool"], "a tool")} if given.get("tool") else {}


def controller_settings(given: Given) -> Values:
    """Return what launch/link.launch tells gateway and mock of the controller: make, cycle, and the text of its file."""
    path = given.get("ethernet_xml", NONE)
    text = {} if path == NONE else {"ethernet_xml": read_text(path)}
    return {"make": given.get("controller_make", DEFAULT), "cycle": int(given.get("rsi_cycle", "4"))} | text


def read_mapping(path: str, what: str) -> Values:
    """Return the content of a YAML file; ConfigurationError when it is not a mapping of `what`."""
    try:
        content = yaml.safe_load(read_text(path))
    except yaml.YAMLError as error:
        raise ConfigurationError(path, " ".join(str(error).split()), Sentence("expected.yaml_file")) from error
    if not isinstance(content, dict):
        raise ConfigurationError(path, content, Sentence("expected.mapping", what=what))
    return content
