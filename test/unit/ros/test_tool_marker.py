"""The menu of the marker at the tool: what it decides about, whom it obeys; and how the marker looks."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from executor_bench import ROBOT, make_plan
from visualization_msgs.msg import InteractiveMarkerFeedback

from construction_twin.kinematics.chain import Chain
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.ros.shared import tool_marker_menu as module
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.tool_marker_menu import SHOWN, MarkerGoal, ToolMarkerMenu


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
        self.client, self.goal = Client(), MarkerGoal()
        self.menu = ToolMarkerMenu(
            self.client,
            lambda: self.plan,
            self.goal,
            ROBOT.home,
            "Ada",
            self.said.append,
            run=lambda _, action: action(),
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
    world.goal.drag(Chain(ROBOT).forward(ROBOT.home))
    world.menu.choose("Plan")
    assert world.client.calls == ["pose"] and world.said[-1] == "Plan: planned"
    world.menu.choose("Back to the tool")
    assert world.goal.pose is None


def test_one_plan_at_a_time(world):
    def second(_asked) -> Outcome:
        world.menu.choose("Plan")
        return Outcome(True, "planned")

    world.goal.drag(Chain(ROBOT).forward(ROBOT.home))
    world.client.plan = second
    world.menu.choose("Plan")
    assert [line for line in world.said if "being made already" in line] and world.said[-1] == "Plan: planned"
