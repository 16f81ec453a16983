"""The documents say what the code does: every name a user can reach is written down, every link and every quoted message exists."""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pydantic
import pytest
import yaml
from evaluation_samples import run
from gateway_cell import following

from construction_twin.broker.access import PLC, ROLES
from construction_twin.evaluation.summary import evaluate, summarise
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.gateway import State
from construction_twin.gateway.states import Mode
from construction_twin.link.remote_review import PlanView, review_answer
from construction_twin.link.status_values import status_values
from construction_twin.mqtt.account import Account
from construction_twin.mqtt.messages import Topics

ROOT = Path(__file__).resolve().parents[3]
NODE_MODULES = ROOT / "src/construction_twin/ros/nodes"
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
INTERFACE = (ROOT / "docs/interface.md").read_text()
README = (ROOT / "README.md").read_text()
BROKER = (ROOT / "docs/broker.md").read_text()
TROUBLESHOOTING = (ROOT / "docs/troubleshooting.md").read_text()


def code_words(text: str) -> set[str]:
    """Return the names in code spans, also where several stand in one."""
    return {word for span in re.findall(r"`([^`\n]+)`", text) for word in re.split(r"[\s,:\[\]]+", span)}


CODE_WORDS = code_words(INTERFACE)
NODES = [
    *sorted(p for p in NODE_MODULES.glob("*.py") if p.stem != "__init__"),
    ROOT / "examples/separation/separation_node.py",
]


def ros_names(file: Path) -> set[str]:
    """Return the topics and services a node's code opens, private ones with the node's name in front."""
    calls = r"(?:Publisher|Subscriber|JointPublisher|JointSubscriber|Service|ServiceProxy)\(\s*\"([^\"]+)\""
    node = file.stem.removesuffix("_node")
    return {name.replace("~", f"{node}/") for name in re.findall(calls, file.read_text())}


def undocumented(names) -> list[str]:
    return sorted(set(names) - CODE_WORDS)


def test_scan_of_the_code_finds_what_is_there():
    found = set().union(*map(ros_names, NODES))
    assert {"plan", "command/joint_states", "mock_rsi/status", "review_plan", "mqtt_bridge/stop"} <= found


@pytest.mark.parametrize("file", NODES, ids=lambda file: file.stem)
def test_topics_and_services_are_documented(file):
    assert undocumented(ros_names(file)) == []


@pytest.mark.parametrize("file", sorted((ROOT / "config").glob("*.yaml")), ids=lambda file: file.stem)
def test_configuration_keys_are_documented(file):
    assert undocumented(yaml.safe_load(file.read_text())) == []


@pytest.mark.parametrize("file", NODES, ids=lambda file: file.stem)
def test_parameters_are_documented(file):
    module = importlib.import_module(
        file.stem if file.parent.name == "separation" else f"construction_twin.ros.nodes.{file.stem}"
    )
    models = [
        value for value in vars(module).values() if isinstance(value, type) and issubclass(value, pydantic.BaseModel)
    ]
    assert undocumented(name for model in models for name in model.model_fields) == []


@pytest.mark.parametrize("file", sorted((ROOT / "launch").glob("*.launch")), ids=lambda file: file.stem)
def test_launch_arguments_are_documented(file):
    assert undocumented(arg.get("name") for arg in ElementTree.parse(file).getroot().findall("arg")) == []


@pytest.mark.parametrize("file", sorted((ROOT / "nodes").iterdir()), ids=lambda file: file.name)
def test_executables_have_a_heading(file):
    assert re.search(rf"^##+ .*\b{file.name}\b|`{file.name} ", INTERFACE, re.MULTILINE)


def test_gateway_interface_is_documented():
    topics = [value for value in vars(Topics).values() if isinstance(value, property)]
    assert undocumented(topic.fget(Topics("twin", "kr120")) for topic in topics) == []
    assert undocumented(field.name for field in dataclasses.fields(GatewayConfig)) == []
    assert undocumented(state.value for state in State) == []


def test_gateway_status_is_documented():
    status = following().gateway.status()
    assert undocumented(status) == []
    assert undocumented([*status["playout"], *status["intruder"]]) == []
    assert undocumented(status_values(status)) == []
    assert undocumented(mode.value for mode in Mode) == []


def test_gateway_counters_are_documented():
    files = ("service", "gateway", "player", "rsi_session", "command_stream", "command_intake", "inbox")
    code = "".join((ROOT / f"src/construction_twin/gateway/{file}.py").read_text() for file in files)
    # a refusal is documented by its reason
    counters = re.findall(r"counters\[\"(\w+)\"", code)
    refused = r"(?:PayloadError|MotionRefused|refusals\.\w+|_refuse)\(\s*\"(\w+)\""
    reasons = re.findall(refused, code)
    assert {"settling", "cycles_without_command"} <= set(counters)
    assert {"duplicate", "lead", "repeated", "verb", "source", "retained"} <= set(reasons)
    assert undocumented([*counters, *reasons, "arm", "stop", "reset", "end"]) == []


def test_keys_of_plan_review_and_account_files_are_documented():
    empty = PlanView("", "", "", "", "", "", 0, 0.0, 0.0, (), (), (), (), None, {})
    keys = {*json.loads(empty.to_json(2)), *json.loads(review_answer(None, True, ""))}
    keys |= {field.name for field in dataclasses.fields(Account)} - {"name"}
    assert sorted(keys - code_words(BROKER)) == []


def test_roles_and_their_topics_are_documented():
    rows = dict(re.findall(r"^\| (\w+)(?: \(`--plc`\))? \| `kr120-.*?\| (.*) \|$", BROKER, re.MULTILINE))
    assert set(rows) == {*ROLES, PLC}
    for role, row in rows.items():
        rules = (ROOT / f"config/mosquitto/{role}.acl").read_text()
        topics = set(re.findall(r"^topic \w+ \$topics/([a-z/]+)$", rules, re.MULTILINE))
        assert topics == code_words(row), role


@pytest.mark.parametrize(
    "file",
    [
        "gateway/service",
        "mock/program",
        "ros/commands/evaluate",
        "ros/shared/gateway_config",
        "broker/start",
        "broker/make_site",
        "views/arguments",
    ],
)
def test_command_line_options_are_documented(file):
    text = (ROOT / f"src/construction_twin/{file}.py").read_text()
    options = re.findall(r"(?:add_argument|option|add)\(\s*\"(--[a-z-]+)\"", text)
    assert options
    assert undocumented(options) == []


def test_keys_of_the_summary_are_documented():
    assert undocumented(summarise(evaluate(run()))) == []


@pytest.mark.parametrize("file", DOCUMENTS, ids=lambda file: file.name)
def test_relative_links_lead_somewhere(file):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)", file.read_text()):
        path = (file.parent / target).resolve() if target else file
        assert path.exists(), f"{file.name} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", path.read_text(), re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}
            assert anchor in slugs, f"{file.name} links to {target}#{anchor}"


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {name for file in DOCUMENTS for name in re.findall(r"(?:`|^)make ([a-z]+)", file.read_text(), re.MULTILINE)}
    assert {"demo", "test"} <= named <= targets


def test_services_called_in_the_readme_exist():
    known = set().union(*map(ros_names, NODES))
    called = re.findall(r"rosservice call /kr120/(\S+?)[\s`]", README)
    assert called
    assert set(called) <= known


def test_messages_in_the_troubleshooting_are_the_programs_own():
    """Own sentences only: what ROS or Python says cannot be looked up here."""
    foreign = ("No module named", "rospy", "is neither a launch file", "Couldn't find executable")
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "setup").glob("*.sh"), *(ROOT / "scripts").glob("*")]
    code = "".join(file.read_text() for file in files if file.is_file())
    code = re.sub(r"\"\s*f?\"", "", code)  # a sentence may be written in several pieces
    code = re.sub(r"\{[^{}\n]*\}", "*", code)
    quotes = re.findall(r"`([^`]+)`", "\n".join(re.findall(r"^## (.*)$", TROUBLESHOOTING, re.MULTILINE)))
    assert len(quotes) > 20
    for quote in quotes:
        if not any(part in quote for part in foreign):
            # numbers and names in the document stand where the code has a placeholder
            assert quote in code or re.search(as_template(quote), code), quote


def as_template(quote: str) -> str:
    """Return a pattern for a message whose numbers may be placeholders in the code."""
    return re.sub(r"TCP|18830|MQTT\\ broker", lambda found: rf"(?:\*|{found.group()})", re.escape(quote))


def test_every_package_earns_its_place():
    text = (ROOT / "docs/dependencies.md").read_text()
    for name in ("requirements.txt", "debian-packages.txt"):
        lines = (ROOT / "setup" / name).read_text().splitlines()
        packages = [line.split("==")[0].strip() for line in lines if line.strip() and not line.startswith("#")]
        assert [package for package in packages if f"`{package}`" not in text] == []


def test_readme_stays_short():
    assert len(README.splitlines()) <= 250
