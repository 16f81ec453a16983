"""The marker at the tool: its goal, its menu, what that decides about, and whose clicks count."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from executor_bench import ROBOT, make_plan
from interactive_markers import interactive_marker_server as stock
from visualization_msgs.msg import InteractiveMarker, InteractiveMarkerFeedback

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.nodes import tool_marker as module
from construction_twin.ros.nodes.tool_marker import REACHED, SHOWN, MarkerServer, ToolMarkerMenu, moved


class Client:
    """An OperatorClient that notes what it is asked for."""

    def __init__(self):
        self.reviews: list[tuple] = []
        self.calls: list[str] = []

    def review(self, verdict: ReviewRequest) -> Outcome:
        self.reviews.append((verdict.plan_id, verdict.plan_hash, verdict.approve, verdict.reviewer))
        return Outcome(True, "done")

    def trigger(self, service: str) -> Outcome:
        self.calls.append(service)
        return Outcome(True, "stopped")

    def plan(self, asked: GoalRequest) -> Outcome:
        self.calls.append(asked.kind)
        return Outcome(True, "planned")

    def preview(self) -> Outcome:
        return Outcome(True, "shown")


class World:
    """A menu, its operator and a clock."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        self.plan = None
        self.said: list[str] = []
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: self.now))
        self.client = Client()
        self.menu = ToolMarkerMenu(
            self.client, lambda: self.plan, ROBOT.home, "Ada", self.said.append, run=lambda _, action: action()
        )

    def show(self, plan) -> None:
        """Let a plan wait for a verdict, and the marker say so."""
        self.plan = plan
        self.menu.show(plan.id)


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


@pytest.mark.parametrize(("entry", "approve"), [("Approve", True), ("Reject", False)])
def test_a_plan_that_was_looked_at_is_decided_about(world, entry, approve):
    plan = make_plan("p1")
    world.show(plan)
    world.now += SHOWN
    world.show(plan)
    world.menu.choose(entry)
    assert world.client.reviews == [("p1", plan.hash, approve, "Ada")] and world.said[-1] == f"{entry}: done"


def test_a_plan_that_came_with_the_click_is_not(world):
    world.show(make_plan("p1"))
    world.now += 10.0
    world.plan = make_plan("p2")  # not drawn yet
    world.menu.choose("Approve")
    assert "only just come" in world.said[-1]
    world.show(world.plan)
    world.now += 0.9 * SHOWN
    world.menu.choose("Approve")
    assert "only just come" in world.said[-1] and world.client.reviews == []
    world.now += 0.2 * SHOWN
    world.menu.choose("Approve")
    assert [plan_id for plan_id, *_ in world.client.reviews] == ["p2"]


def test_without_a_plan_there_is_nothing_to_decide(world):
    world.menu.choose("Approve")
    assert "no plan waits" in world.said[-1] and world.client.reviews == []


def test_stop_is_heard_from_every_client(world):
    stop = next(handle for handle, title in titles(world.menu).items() if title == "Stop")
    feedback = InteractiveMarkerFeedback(event_type=InteractiveMarkerFeedback.MENU_SELECT, menu_entry_id=stop)
    for feedback.client_id in ("one rviz", "another"):
        world.menu.on_feedback(feedback)
    feedback.menu_entry_id = stop - 1
    world.menu.on_feedback(feedback)
    assert world.client.calls == ["stop", "stop"]


def titles(menu: ToolMarkerMenu) -> dict[int, str]:
    """Return the entries of a menu as rviz is told of them."""
    marker = SimpleNamespace(menu_entries=[])
    server = SimpleNamespace(get=lambda _: marker, insert=lambda *_: None, setCallback=lambda *_: None)
    menu.attach(server, "tool")
    return {entry.id: entry.title for entry in marker.menu_entries}


def test_a_plan_needs_a_goal(world):
    world.menu.choose("Plan")
    assert "drag it to a goal first" in world.said[-1] and world.client.calls == []
    world.menu.goal = Chain(ROBOT).forward(ROBOT.home)
    world.menu.choose("Plan")
    assert world.client.calls == ["pose"] and world.said[-1] == "Plan: planned"
    world.menu.choose("Back to the tool")
    assert world.menu.goal is None


def test_one_plan_at_a_time(world):
    def second(_asked) -> Outcome:
        world.menu.choose("Plan")
        return Outcome(True, "planned")

    world.menu.goal = Chain(ROBOT).forward(ROBOT.home)
    world.client.plan = second
    world.menu.choose("Plan")
    assert [line for line in world.said if "being made already" in line] and world.said[-1] == "Plan: planned"


# -- its goal


def test_a_goal_that_a_plan_led_to_is_told_from_another(world):
    chain, plan, menu = Chain(ROBOT), make_plan("p1"), world.menu
    begin, end = (chain.forward(plan.trajectory.positions[index]) for index in (0, -1))
    menu.goal = begin
    menu.drop_reached_goal(end)
    assert menu.goal is begin
    menu.goal = end
    menu.drop_reached_goal(chain.forward(plan.trajectory.positions[-1]))
    assert menu.goal is None
    menu.drop_reached_goal(end)
    assert menu.goal is None


def test_moved_is_position_or_rotation():
    origin = Pose(np.zeros(3), np.eye(3))
    assert not moved(origin, Pose(np.full(3, 0.9 * REACHED), np.eye(3)), REACHED)
    assert moved(origin, Pose(np.array([0.0, 1.1 * REACHED, 0.0]), np.eye(3)), REACHED)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert moved(origin, Pose(np.zeros(3), turned), REACHED)


# -- whose clicks count


@pytest.fixture
def made(monkeypatch):
    """A server without ROS around it, what it refused, and what it handed on."""
    for name in ("Publisher", "Subscriber", "Timer"):
        monkeypatch.setattr(stock.rospy, name, lambda *_, **__: SimpleNamespace(publish=lambda _: None))
    # the stock server takes nothing from a second client for a second
    clock = itertools.count(1000, 2)
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(next(clock))))
    refused, taken = [], []
    server = MarkerServer("tool_marker", lambda *said: refused.append(said))
    server.insert(InteractiveMarker(name="tool"), taken.append)
    server.applyChanges()
    return server, refused, taken


def sent_click(client: str, sender: str) -> InteractiveMarkerFeedback:
    feedback = InteractiveMarkerFeedback(
        client_id=client, marker_name="tool", event_type=InteractiveMarkerFeedback.MENU_SELECT, menu_entry_id=3
    )
    feedback._connection_header = {"callerid": sender} if sender else {}
    return feedback


def test_the_click_of_an_rviz_is_taken(made):
    server, refused, taken = made
    server.processFeedback(sent_click("/rviz_1234/Marker", "/rviz_1234"))
    assert [each.menu_entry_id for each in taken] == [3] and refused == []


@pytest.mark.parametrize("sender", ["/play_1", "/rviz_12", ""])
def test_a_click_that_is_played_is_refused_and_named(made, sender):
    server, refused, taken = made
    server.processFeedback(sent_click("/rviz_1234/Marker", sender))
    assert taken == [] and len(refused) == 1
    reason, sentence = refused[0]
    assert reason == "publisher" and "/rviz_1234/Marker" in sentence and (sender or "without a name") in sentence
