"""Who is heard on which stream, and that what a callback did not foresee is not swallowed."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
import rospy

from construction_twin.core.errors import ConfigurationError
from construction_twin.ros.transport import subscriber as module
from construction_twin.ros.transport.subscriber import FOR_ANYBODY, PUBLISHERS, Subscriber, publisher_of

#: What the issue names: the gate opens, stays open or the arm moves because of these.
GATE = {"physical/feedback", "twin/joint_states", "physical/joint_states", "sync", "link", "scene", "conflict", "plan"}
#: An approval, a switch or the next segment of a work plan depends on these.
GATE |= {"rehearsal", "tool", "tool_command", "execution", "engagement", "speed_limit_in_force"}


class Master:
    """Parameters, names and subscriptions of a node in /kr120."""

    def __init__(self, monkeypatch):
        self.parameters: dict[str, dict] = {}
        self.connections: list[SimpleNamespace] = []
        self.refused: list[tuple[str, str]] = []
        monkeypatch.setattr(rospy, "get_param", lambda name, default: self.parameters.get(self.resolve(name), default))
        monkeypatch.setattr(rospy, "resolve_name", self.resolve)
        monkeypatch.setattr(rospy, "Subscriber", self.subscribe)

    @staticmethod
    def resolve(name: str) -> str:
        """Return a name as rospy resolves it."""
        return name if name.startswith("/") else f"/kr120/{name}"

    def subscribe(self, topic, kind, receive, **_):
        """Take a subscription."""
        self.receive = receive
        return SimpleNamespace(
            resolved_name=self.resolve(topic),
            impl=SimpleNamespace(connections=self.connections),
            get_num_connections=lambda: len(self.connections),
        )

    def deliver(self, **header) -> None:
        """Hand a message on as rospy does."""
        self.receive(SimpleNamespace(_connection_header=header))

    def refuse(self, reason: str, sentence: str) -> None:
        """Count a refusal."""
        self.refused.append((reason, sentence))


@pytest.fixture
def master(monkeypatch):
    return Master(monkeypatch)


def test_every_stream_that_moves_something_has_one_publisher():
    assert set(PUBLISHERS) >= GATE | {"next/joint_states", "command/joint_states"}


@pytest.mark.parametrize(
    "topic, publisher",
    [
        ("sync", "/kr120/pca_monitor"),
        ("physical/feedback", "/kr120/mqtt_bridge"),
        ("/kr120_b/twin/joint_states", "/kr120_b/virtual_robot"),
        ("/kr120_b/plan", "/kr120_b/planner"),
        ("mock_rsi/joint_states", None),
        ("speed_limit", None),
        ("speed_limit_in_force", "/kr120/pca_monitor"),
    ],
)
def test_a_publisher_is_a_node_of_the_stream_s_own_robot(master, topic, publisher):
    assert publisher_of(topic) == publisher


def test_another_publisher_can_be_named_for_all_nodes_of_a_robot(master):
    master.parameters = {
        "/kr120/publishers": {"plan": "my_planner"},
        "/kr120_b/publishers": {"plan": "/elsewhere/planner"},
    }
    assert publisher_of("plan") == "/kr120/my_planner" and publisher_of("/kr120_b/plan") == "/elsewhere/planner"
    assert publisher_of("sync") == "/kr120/pca_monitor"


@pytest.mark.parametrize("topic", FOR_ANYBODY)
def test_a_request_is_heard_from_anybody_until_one_node_is_named(master, topic):
    assert publisher_of(topic) is None
    master.parameters = {"/kr120/publishers": {topic: "separation"}}
    assert publisher_of(topic) == "/kr120/separation"
    heard = []
    Subscriber(topic, object, heard.append, master.refuse, queue_size=5)
    master.deliver(callerid="/play_1790000000123")
    master.deliver(callerid="/kr120/separation")
    assert len(heard) == 1 and [reason for reason, _ in master.refused] == ["publisher"]


@pytest.mark.parametrize("named", [[], "planner", {"plans": "planner"}, {"plan": 5}, {"plan": ""}])
def test_a_parameter_that_names_no_publishers_is_refused_at_the_start(master, named):
    master.parameters = {"/kr120/publishers": named}
    with pytest.raises(ConfigurationError, match="/kr120/publishers"):
        publisher_of("sync")


@pytest.mark.parametrize("topic", sorted(GATE))
@pytest.mark.parametrize("header", [{"callerid": "/play_1790000000123"}, {"callerid": "/kr120/recorder"}, {}])
def test_a_stranger_is_refused_counted_and_named(master, topic, header):
    heard = []
    Subscriber(topic, object, heard.append, master.refuse, queue_size=5)
    master.deliver(**header)
    assert heard == []
    ((reason, sentence),) = master.refused
    assert reason == "publisher"
    assert header.get("callerid", "without a name") in sentence and f"/kr120/{topic}" in sentence
    assert publisher_of(topic) in sentence


def test_the_publisher_is_heard(master):
    heard = []
    Subscriber("link", object, heard.append, master.refuse, queue_size=5)
    master.deliver(callerid="/kr120/mqtt_bridge")
    assert len(heard) == 1 and master.refused == []


def test_a_topic_without_a_publisher_of_its_own_is_heard_from_everybody(master):
    heard = []
    Subscriber("speed_limit", object, heard.append, master.refuse, queue_size=5)
    master.deliver(callerid="/anybody")
    assert len(heard) == 1


def test_a_stranger_s_connection_does_not_keep_a_stream_alive(master):
    scene = Subscriber("scene", object, lambda _: None, master.refuse, queue_size=5)
    limit = Subscriber("speed_limit", object, lambda _: None, master.refuse, queue_size=5)
    master.connections.append(SimpleNamespace(callerid_pub="/play_1"))
    assert (scene.get_num_connections(), limit.get_num_connections()) == (0, 1)
    master.connections.append(SimpleNamespace(callerid_pub="/kr120/scene"))
    assert scene.get_num_connections() == 1


def test_what_a_callback_did_not_foresee_goes_where_a_thread_s_errors_go(master, monkeypatch):
    seen = []
    monkeypatch.setattr(threading, "excepthook", seen.append)

    def fail(_):
        raise IndexError("no points")

    module.Subscriber("plan", object, fail, master.refuse, queue_size=5)
    master.deliver(callerid="/kr120/planner")
    assert [type(args.exc_value) for args in seen] == [IndexError]
    assert seen[0].thread is threading.current_thread() and seen[0].exc_traceback is not None
