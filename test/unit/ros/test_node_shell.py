"""A node is declared once: what its process starts with is what `preflight` checks before anything starts."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

import pytest
import rospy
from chain_samples import ROBOT
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolRequest, SetBoolResponse, Trigger, TriggerRequest
from unplugged import Unplugged

from construction_twin.core.errors import ConfigurationError, PoseUnknownError
from construction_twin.ros import nodes
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.shared import node_shell as module
from construction_twin.ros.shared.diagnostics import OK, Diagnosis
from construction_twin.ros.shared.node_shell import (
    Interface,
    NodeIO,
    NodeShell,
    NodeTimer,
    PolledPose,
    PoseSubscription,
    Publication,
    Served,
    SharedParameter,
    Subscription,
)
from construction_twin.validation import StrictModel

ROOT = Path(__file__).resolve().parents[3]


def shells() -> dict[str, NodeShell]:
    modules = (
        importlib.import_module(f"{nodes.__name__}.{found.name}") for found in pkgutil.iter_modules(nodes.__path__)
    )
    return {each.NODE.name: each.NODE for each in modules if hasattr(each, "NODE")}


class Settings(StrictModel):
    rate: float


def refuse_fast(settings: Settings, robot, _shared) -> None:
    if settings.rate > 10.0:
        raise ConfigurationError("rate", settings.rate, f"at most 10 for {robot.name}")


def started(monkeypatch, values: dict) -> list:
    """Run the node with private parameters; return what it was started with."""
    found = []
    start = lambda settings, robot, _ports: found.append((settings.rate, robot))  # noqa: E731
    shell = NodeShell("fast", Settings, start, Interface(), refuse_fast)
    monkeypatch.setattr(rospy, "get_param", lambda name, default=None: values)
    monkeypatch.setattr(rospy, "get_name", lambda: "/kr120/fast")
    monkeypatch.setattr(module, "robot_from_parameters", lambda parameters: ROBOT)
    monkeypatch.setattr(module, "run_node", lambda name, start, refused: start())
    shell.run()
    return found


def test_a_node_starts_with_parameters_and_robot(monkeypatch):
    assert started(monkeypatch, {"rate": 5.0}) == [(5.0, ROBOT)]


@pytest.mark.parametrize("values, says", [({"rate": 50.0}, "at most 10 for kr120"), ({}, "rate")])
def test_parameters_with_which_it_cannot_work_are_refused_before_it_is_made(monkeypatch, values, says):
    with pytest.raises(ConfigurationError, match=says):
        started(monkeypatch, values)


def test_every_node_runs_its_shell():
    programs = {path.name for path in (ROOT / "nodes").iterdir() if path.is_file()}
    for name, shell in shells().items():
        assert name in programs and issubclass(shell.settings, StrictModel)


class Node:
    """Says what it heard."""

    def __init__(self, settings: Settings, robot, node_io: NodeIO):
        self.heard: list = []
        self.node_io = node_io
        self.said = node_io.publishers["said"]
        self.found = node_io.parameters
        self.said.publish(String("first"))

    def on_word(self, message: String) -> None:
        self.heard.append(message.data)

    def on_pose(self, stamp: int, q: tuple) -> None:
        self.heard.append((stamp, q))

    def on_ask(self, _request: TriggerRequest) -> str:
        if self.heard == ["no"]:
            raise PoseUnknownError("pose", 2.0, 1.0)
        return "yes"

    def on_set(self, request: SetBoolRequest) -> Outcome:
        if not request.data:
            raise ConfigurationError("data", request.data, "true")
        return Outcome(True, "set", expired=True, fields={"plan_id": "a field that the answer has not"})


INTERFACE = Interface(
    diagnose=lambda node: Diagnosis(OK, f"heard {len(node.heard)}"),
    parameters=(SharedParameter("cell"), SharedParameter("waits", "", written=True)),
    publishes=(
        Publication("said", String, queue_size=3, latch=True, tcp_nodelay=True),
        Publication("none", "no_such_msgs/Thing", queue_size=1),
    ),
    polls=(PolledPose("twin/joint_states"), PolledPose("slow", when=lambda settings: settings.rate < 1.0)),
    subscribes=(
        Subscription("word", String, Node.on_word, queue_size=2),
        Subscription("often", String, Node.on_word, queue_size=2, when=lambda settings: settings.rate > 5.0),
        PoseSubscription("pose", Node.on_pose),
    ),
    serves=(
        Served("ask", Trigger, Node.on_ask),
        Served("set", SetBool, Node.on_set, reason="setting", refused=lambda node, request: {"message": f"{request.data}: no"}),
    ),
    timers=(NodeTimer(lambda settings: 1.0 / settings.rate, lambda node: node.heard.append(node.node_io.connections("word"))),),
)  # fmt: skip


def unplugged(monkeypatch, rate: float = 2.0, **options) -> Unplugged:
    return Unplugged(monkeypatch, NodeShell("fast", Settings, Node, INTERFACE), Settings(rate=rate), ROBOT, **options)


def test_shared_parameters_are_read_before_the_node_is_made_and_only_a_kept_one_is_written(monkeypatch):
    made = unplugged(monkeypatch, parameters={"waits": "stopped", "other": 1})
    assert made.node.found == {"cell": None, "waits": "stopped"}
    made.node.node_io.parameter_writer("waits")("")
    assert made.parameters == {"waits": "", "other": 1}
    for name in ("cell", "other"):
        with pytest.raises(AssertionError):
            made.node.node_io.parameter_writer(name)


def test_what_is_published_is_there_before_the_node_what_it_hears_after_it_and_requests_come_last(monkeypatch):
    found = unplugged(monkeypatch)
    assert found.opened == [
        ("publishes", "said"), ("reads", "twin/joint_states"), ("hears", "word"), ("hears", "pose"), ("serves", "ask"),
        ("serves", "set"),
    ]  # fmt: skip
    assert [message.data for message in found.published["said"]] == ["first"]


def test_a_topic_is_there_where_the_parameters_or_installed_types_want_it(monkeypatch):
    few, many = unplugged(monkeypatch), unplugged(monkeypatch, 10.0)
    assert "often" not in few.callbacks and "often" in many.callbacks
    assert set(few.node.node_io.publishers) == {"said"} and set(few.node.node_io.poses) == {"twin/joint_states"}


def test_what_comes_in_goes_directly_to_the_node(monkeypatch):
    found = unplugged(monkeypatch)
    assert found.callbacks["pose"] == found.node.on_pose
    found.callbacks["word"](String("hello"))
    found.callbacks["pose"](5, (0.0,))
    found.timers[0](None)
    assert found.node.heard == ["hello", (5, (0.0,)), 1]
    assert found.services["ask"](TriggerRequest()).message == "yes"


def test_a_typed_error_of_a_handler_becomes_an_answer_and_is_counted_and_written(monkeypatch):
    found = unplugged(monkeypatch)
    found.callbacks["word"](String("no"))
    refused = found.services["ask"](TriggerRequest())
    assert not refused.success and "pose" in refused.message
    assert found.refused == [("PoseUnknownError", refused.message)]
    assert found.services["set"](SetBoolRequest(True)) == SetBoolResponse(True, "set")
    # counted as what the service says, with the fields that it adds to a refusal
    assert found.services["set"](SetBoolRequest(False)) == SetBoolResponse(False, "False: no")
    assert [reason for reason, _ in found.refused] == ["PoseUnknownError", "setting"]
