"""The marker's node without ROS around it: what its menu decides about, and what it shows."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from executor_bench import ROBOT, make_plan
from geometry_msgs.msg import Pose
from visualization_msgs.msg import InteractiveMarkerFeedback

from construction_twin.core.errors import RequestRefused
from construction_twin.kinematics.chain import Chain
from construction_twin.ros.nodes import tool_marker as module
from construction_twin.ros.nodes.tool_marker import SHOWN, ToolMarkerNode
from construction_twin.ros.shared.tool_marker_shapes import tool_marker, verdict_markers
from construction_twin.views.reachability import Reach


class World:
    """A node that shows what the listener tells, and a clock."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        self.plan = None
        self.reviews: list[tuple] = []
        self.stops: list[str] = []
        monkeypatch.setattr(module.time, "monotonic", lambda: self.now)
        node = self.node = ToolMarkerNode.__new__(ToolMarkerNode)
        node._frame, node._place, node._drawn, node._shown = "base", Chain(ROBOT).forward(ROBOT.home), None, ("", 0.0)
        node._verdict, node._problem, node._said = None, "nothing is known", ""
        node._settings = SimpleNamespace(scale=0.6, reviewer="Ada")
        node._listener = SimpleNamespace(under_review=lambda: self.plan)
        node._verdicts = SimpleNamespace(publish=lambda _: None)
        node._client = SimpleNamespace(review=self.review, trigger=self.stops.append)
        node._start = lambda title, action: action()
        node._stop_entry = 6

    def review(self, plan_id, plan_hash, approve, reviewer, reason) -> str:
        self.reviews.append((plan_id, plan_hash, approve, reviewer))
        return "done"

    def show(self, plan) -> None:
        """Let a plan wait for a verdict, and the marker say so."""
        self.plan = plan
        self.node._draw()


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


@pytest.mark.parametrize("approve", [True, False])
def test_a_plan_that_was_looked_at_is_decided_about(world, approve):
    plan = make_plan("p1")
    world.show(plan)
    world.now += SHOWN
    world.node._draw()
    assert world.node._review(approve) == "done"
    assert world.reviews == [("p1", plan.hash, approve, "Ada")]


def test_a_plan_that_came_with_the_click_is_not(world):
    world.show(make_plan("p1"))
    world.now += 10.0
    world.plan = make_plan("p2")  # not drawn yet
    with pytest.raises(RequestRefused, match="only just come"):
        world.node._review(True)
    world.node._draw()
    world.now += 0.9 * SHOWN
    with pytest.raises(RequestRefused, match="only just come"):
        world.node._review(True)
    world.now += 0.2 * SHOWN
    world.node._review(True)
    assert [plan_id for plan_id, *_ in world.reviews] == ["p2"]


def test_without_a_plan_there_is_nothing_to_decide(world):
    with pytest.raises(RequestRefused, match="no plan waits"):
        world.node._review(True)


def test_stop_is_heard_from_every_client(world):
    feedback = InteractiveMarkerFeedback(event_type=InteractiveMarkerFeedback.MENU_SELECT, menu_entry_id=6)
    for feedback.client_id in ("one rviz", "another"):
        world.node._on_any_feedback(feedback)
    feedback.menu_entry_id = 5
    world.node._on_any_feedback(feedback)
    assert world.stops == ["stop", "stop"]


def test_a_goal_that_a_plan_led_to_is_told_from_another(world):
    node, plan = world.node, make_plan("p1")
    node._chain = Chain(ROBOT)
    node._listener.plan = lambda plan_id: plan if plan_id == "p1" else None
    reached, other = (node._chain.forward(plan.trajectory.positions[end]) for end in (-1, 0))
    assert node._led_to("p1", reached)
    assert not node._led_to("p1", other) and not node._led_to("p0", reached)


def test_the_handle_lies_outside_of_the_verdict():
    """rviz gives a click to what it meets first: a sphere over the handle would swallow the menu."""
    (menu,) = [control for control in tool_marker("base", Pose(), 0.6).controls if control.name == "menu"]
    sphere = verdict_markers("base", Pose(), 0.6, Reach.FREE, ["free"]).markers[0]
    assert menu.markers[0].scale.x > sphere.scale.x > 0.0
    assert menu.markers[0].color.a < 0.5


def test_a_longer_text_ends_further_below_and_begins_where_a_short_one_does():
    short, longer = (verdict_markers("base", Pose(), 1.0, None, ["a line"] * n).markers[1] for n in (1, 4))
    assert longer.pose.position.z < short.pose.position.z < -0.5
    half = 0.5 * 1.2 * short.scale.z
    assert longer.pose.position.z + 4 * half == pytest.approx(short.pose.position.z + half)
