"""The listener behind command line, watch and marker: the newest of each report, and who has fallen silent."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest
from construction_twin.msg import Execution, Link, Plan, Review, Sync
from executor_bench import ROBOT, make_plan

from construction_twin.ros.shared import robot_client as module
from construction_twin.ros.shared.robot_client import RobotListener


class World:
    """ROS and the clock, without either."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        self.publishers = 1
        patch = monkeypatch.setattr
        patch(module.time, "monotonic", lambda: self.now)
        patch(module.rospy, "get_time", lambda: self.now)
        self.callbacks: dict[str, Callable] = {}
        patch(module, "Subscriber", self.subscribe)
        patch(module, "plan_from_msg", lambda message: make_plan(message.id))
        self.listener = RobotListener("/kr120", ROBOT)

    def subscribe(self, topic: str, _kind: type, callback: Callable, *_, **__) -> SimpleNamespace:
        self.callbacks[topic] = callback
        return SimpleNamespace(get_num_connections=lambda: self.publishers)

    def receive(self, name: str, message) -> None:
        self.callbacks[f"/kr120/{name}"](message)

    def all_report(self) -> None:
        self.receive("link", Link(text="ARMED"))
        self.receive("sync", Sync(text="IN_SYNC"))
        self.receive("execution", Execution(text="IDLE"))


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


def test_other_reports_leave_the_plan_alone(world):
    world.receive("plan", Plan(id="p1"))
    for name, message in (("sync", Sync()), ("link", Link()), ("execution", Execution(plan_id="p0"))):
        world.receive(name, message)
    assert world.listener.under_review().id == "p1"
    assert world.listener.plan("p1").id == "p1" and world.listener.plan("p0") is None
    world.receive("review", Review(plan_id="p1"))
    assert world.listener.under_review() is None


def test_what_is_reported_again_and_again_falls_silent(world):
    world.all_report()
    assert dict(world.listener.snapshot().silent) == {}
    world.now += 2.0
    snapshot = world.listener.snapshot()
    assert dict(snapshot.silent) == {"sync": 2.0}
    world.now += 4.0
    snapshot = world.listener.snapshot()
    assert dict(snapshot.silent) == {"sync": 6.0, "link": 6.0}
    world.all_report()
    assert dict(world.listener.snapshot().silent) == {}


def test_the_executor_is_silent_when_it_is_gone(world):
    world.all_report()
    world.now += 60.0
    assert "execution" not in world.listener.snapshot().silent
    world.publishers = 0
    assert world.listener.snapshot().silent["execution"] == 60.0


def test_who_was_never_heard_is_not_silent_but_unknown(world):
    world.now += 60.0
    assert dict(world.listener.snapshot().silent) == {} and world.listener.snapshot().sync is None
