"""Clicks on the marker count when the rviz that made them sends them, and not when a bag is played."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import pytest
import rospy
from interactive_markers import interactive_marker_server as stock
from visualization_msgs.msg import InteractiveMarker, InteractiveMarkerFeedback

from construction_twin.ros.nodes.tool_marker import MarkerServer


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


def click(client: str, sender: str) -> InteractiveMarkerFeedback:
    feedback = InteractiveMarkerFeedback(
        client_id=client, marker_name="tool", event_type=InteractiveMarkerFeedback.MENU_SELECT, menu_entry_id=3
    )
    feedback._connection_header = {"callerid": sender} if sender else {}
    return feedback


def test_the_click_of_an_rviz_is_taken(made):
    server, refused, taken = made
    server.processFeedback(click("/rviz_1234/Marker", "/rviz_1234"))
    assert [each.menu_entry_id for each in taken] == [3] and refused == []


@pytest.mark.parametrize("sender", ["/play_1", "/rviz_12", ""])
def test_a_click_that_is_played_is_refused_and_named(made, sender):
    server, refused, taken = made
    server.processFeedback(click("/rviz_1234/Marker", sender))
    assert taken == [] and len(refused) == 1
    reason, sentence = refused[0]
    assert reason == "publisher" and "/rviz_1234/Marker" in sentence and (sender or "without a name") in sentence
