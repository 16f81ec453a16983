"""tf for nodes that act on it: a robot's own frames from its own nodes, any other from one node at a time."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from construction_twin.ros.shared import frames as module
from construction_twin.ros.shared.frames import PUBLISHERS, FrameListener
from construction_twin.ros.transport import subscriber

PLAYER = "/play_1790000000123"


class World:
    """Names, connections and a clock around a listener."""

    def __init__(self, monkeypatch):
        self.now = rospy.Time(1000)
        self.connections: list[SimpleNamespace] = []
        self.receive = {}
        self.refused: list[tuple[str, str]] = []
        monkeypatch.setattr(rospy.Time, "now", lambda: self.now)
        monkeypatch.setattr(module.tf2_ros, "Buffer", Buffer)
        monkeypatch.setattr(subscriber.rospy, "Subscriber", self.subscribe)
        self.listener = FrameListener(lambda *said: self.refused.append(said))

    def subscribe(self, topic, kind, receive, **_):
        """Take a subscription."""
        self.receive[topic] = receive
        return SimpleNamespace(resolved_name=topic, impl=SimpleNamespace(connections=self.connections))

    def connect(self, *names: str) -> None:
        """Let these nodes, and no others, be connected."""
        self.connections[:] = [SimpleNamespace(callerid_pub=name) for name in names]

    def publish(self, caller: str, *frames: str, topic: str = "/tf", x: float = 0.0) -> None:
        """Let a node publish frames."""
        message = TFMessage([TransformStamped(child_frame_id=frame) for frame in frames])
        for transform in message.transforms:
            transform.transform.translation.x = x
        message._connection_header = {"callerid": caller} if caller else {}
        self.receive[topic](message)

    @property
    def heard(self) -> dict[str, float]:
        """Where each frame is."""
        return self.listener.buffer.frames


class Buffer:
    """In place of tf2's: remembers the newest of each frame."""

    def __init__(self):
        self.frames: dict[str, float] = {}
        self.cleared = 0

    def set_transform(self, transform, _who):
        """Take a transform."""
        self.frames[transform.child_frame_id] = transform.transform.translation.x

    set_transform_static = set_transform

    def clear(self):
        """Forget."""
        self.cleared += 1


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])
@pytest.mark.parametrize("tree, nodes", PUBLISHERS.items())
@pytest.mark.parametrize("slash", ["", "/"])
def test_a_robot_s_frames_are_believed_from_its_own_nodes_only(world, topic, tree, nodes, slash):
    frames = [f"{slash}kr120/{tree}/link_{k}" for k in range(3)]
    for own in nodes:
        world.publish(f"/kr120/{own}", *frames, topic=topic, x=1.0)
    assert world.refused == [] and set(world.heard.values()) == {1.0} and len(world.heard) == 3
    for stranger in (PLAYER, f"/kr120_2/{nodes[0]}", f"/{nodes[0]}", ""):
        world.publish(stranger, *frames, topic=topic, x=9.0)
    assert set(world.heard.values()) == {1.0}
    # one line for a message, not one for each of its frames
    assert [reason for reason, _ in world.refused] == ["publisher"] * 4
    expected = f"only {' and '.join(f'/kr120/{own}' for own in nodes)} may publish frames of kr120/{tree} on /tf"
    assert world.refused[0][1] == f"message from {PLAYER}; {expected}"
    assert world.refused[3][1] == f"message from a node without a name; {expected}"


def test_a_frame_of_the_cell_has_one_publisher_until_it_is_gone(world):
    world.connect("/site/table", PLAYER)
    world.publish("/site/table", "table", topic="/tf_static", x=1.0)
    world.publish(PLAYER, "table", "chair", topic="/tf_static", x=9.0)
    assert world.heard == {"table": 1.0, "chair": 9.0}
    ((reason, sentence),) = world.refused
    assert reason == "publisher"
    assert sentence == f"message from {PLAYER}; /site/table publishes the frame table on /tf: end one of the two"
    # the site's publisher is started anew, under another name
    world.connect("/site/table_2")
    world.publish("/site/table_2", "table", topic="/tf_static", x=2.0)
    assert world.heard["table"] == 2.0 and len(world.refused) == 1
    world.publish("/site/table_2", "table", topic="/tf_static", x=3.0)
    assert world.heard["table"] == 3.0


@pytest.mark.parametrize("frame", ["map", "model", "kr120/table", "twin/link_1"])
def test_what_is_of_no_robot_s_tree_may_come_from_anybody(world, frame):
    world.publish("/anybody", frame)
    assert set(world.heard) == {frame} and world.refused == []


@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])
@pytest.mark.parametrize("tree", ["simulated", "expected"])
@pytest.mark.parametrize("node", ["/kr120/display", PLAYER])
def test_nothing_is_looked_up_in_a_tree_that_is_only_shown_and_hearing_it_is_no_fault(world, topic, tree, node):
    world.publish(node, f"kr120/{tree}/tool0", f"/kr120/{tree}/link_1", topic=topic)
    assert world.heard == {} and world.refused == []
    # a frame of that name that is of no robot's tree is as any other
    world.publish(PLAYER, tree, f"site/{tree}", topic=topic, x=1.0)
    assert world.heard == {tree: 1.0, f"site/{tree}": 1.0}
