"""Goals and cancels on the wire: what is dropped is counted, and has no result that reads as success."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import genpy
import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus

from construction_twin.extensions.planners.nodes import joint_goals as module
from construction_twin.extensions.planners.nodes.joint_goals import GoalServer, control_messages

MESSAGES = control_messages()


class World:
    """A started server without a ROS master; `goals` are the handles it gave, `sent` what it published by topic."""

    def __init__(self, monkeypatch):
        self.sent: dict[str, list] = {}
        self.goals, self.cancels, self.refused = [], [], []
        self.now = genpy.Time(1000)
        monkeypatch.setattr(rospy.Time, "now", lambda: self.now)
        monkeypatch.setattr(rospy, "Timer", lambda *_: None)
        monkeypatch.setattr(module, "Publisher", self.publisher)
        monkeypatch.setattr(module, "Subscriber", lambda *_, **__: None)
        self.server = GoalServer(
            "follow",
            MESSAGES.FollowJointTrajectoryAction,
            self.goals.append,
            self.cancels.append,
            lambda *said: self.refused.append(said),
            lambda sentence: MESSAGES.FollowJointTrajectoryResult(-5, sentence),
        )
        self.server.start()

    def publisher(self, topic: str, *_, **__):
        """Return a publisher that keeps what it is given."""
        impl = SimpleNamespace(connections=[])
        return SimpleNamespace(publish=self.sent.setdefault(topic, []).append, impl=impl)

    def send(self, name: str, stamp: genpy.Time = genpy.Time(1000)) -> None:
        """Let a client send a goal."""
        goal = MESSAGES.FollowJointTrajectoryActionGoal(goal_id=GoalID(stamp, name))
        goal._connection_header = {"callerid": "/client"}
        self.server.internal_goal_callback(goal)

    def cancel(self, name: str, stamp: genpy.Time = genpy.Time()) -> None:
        """Let a client cancel a goal."""
        self.server.internal_cancel_callback(GoalID(stamp, name))


@pytest.fixture
def world(monkeypatch) -> World:
    return World(monkeypatch)


def test_a_goal_with_the_id_of_another_is_refused_and_counted(world):
    world.send("a")
    assert world.refused == []
    world.send("a")
    assert len(world.goals) == 1 and world.sent["follow/result"] == []
    ((reason, sentence),) = world.refused
    assert reason == "repeated goal"
    assert sentence == (
        "goal 'a' of /client dropped: its id is that of a goal that is there; expected a new one for each goal"
    )


def test_a_goal_whose_cancel_came_first_is_recalled_and_not_successful(world):
    world.cancel("a")
    world.send("a")
    (result,) = world.sent["follow/result"]
    assert (result.status.status, result.status.goal_id.id) == (GoalStatus.RECALLED, "a")
    assert (result.result.error_code, result.result.error_string) == (-5, "cancelled before it came")
    assert world.goals == [] and world.refused == [
        ("repeated goal", "goal 'a' of /client dropped: cancelled before it came")
    ]
    world.send("a")
    assert len(world.sent["follow/result"]) == 1 and len(world.refused) == 2


def test_a_cancel_by_a_clock_that_is_ahead_stops_no_goal_that_comes(world):
    world.send("a")
    world.cancel("", genpy.Time(5000))
    assert len(world.cancels) == 1
    world.send("b", genpy.Time(1001))
    assert len(world.goals) == 2 and world.sent["follow/result"] == []


def test_nor_one_that_comes_while_it_is_taken(world, monkeypatch):
    """The moment between actionlib's part and ours, in which the cancel's stamp is known, is nobody else's."""
    world.send("a")
    other = []
    taken = GoalServer.__mro__[1].internal_cancel_callback

    def taken_slowly(server, goal_id):
        taken(server, goal_id)
        sender = threading.Thread(target=world.send, args=("b", genpy.Time(1001)))
        sender.start()
        # it cannot end before the cancel has: the condition that is awaited here is that it does not
        sender.join(0.2)
        other.append(sender)

    monkeypatch.setattr(GoalServer.__mro__[1], "internal_cancel_callback", taken_slowly)
    world.cancel("", genpy.Time(5000))
    other[0].join()
    assert len(world.goals) == 2 and world.sent["follow/result"] == []


def test_a_client_is_connected_as_long_as_it_hears_the_status_of_its_goals(world):
    connections = world.server.status_pub.impl.connections
    assert not world.server.is_connected("/client")
    connections += [SimpleNamespace(endpoint_id="/rostopic"), SimpleNamespace(endpoint_id="/client")]
    assert world.server.is_connected("/client") and not world.server.is_connected("/client_2")
    del connections[1]
    assert not world.server.is_connected("/client")
