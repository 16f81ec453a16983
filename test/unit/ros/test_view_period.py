"""How often `view` is published, on a clock of its own."""

from __future__ import annotations

import json
import math
import threading
from types import SimpleNamespace

import pytest
import rospy
from bridge_bench import Client, Refusals

from construction_twin.core.errors import PoseUnknownError
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.remote_view import ViewWriter
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import Broker
from construction_twin.ros.nodes import mqtt_planner
from construction_twin.ros.nodes.mqtt_planner import MqttPlanner, Poses, Settings
from construction_twin.ros.transport.latest_pose import StampedPose

JOINTS = Joints(("joint_a1",), (False,))
#: Views until the node is shut down, and the one during which the machine pauses for a second.
VIEWS, PAUSED = 50, 20


class Clock:
    """Time that passes while the node sleeps; it ends the node."""

    def __init__(self):
        self.now, self.shown, self.over = 1000.0, 0, threading.Event()

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.shown += 1
        if self.shown == VIEWS:
            self.over.set()


class PausingClient(Client):
    """A client during one of whose publishes the machine pauses for a second."""

    def __init__(self, clock: Clock):
        super().__init__()
        self.clock, self.at = clock, []

    def loop_stop(self) -> None:
        """Nothing runs."""

    def disconnect(self) -> None:
        """Nothing is connected."""

    def publish(self, topic, payload, *args, **kwargs):
        self.at.append(self.clock.now)
        if len(self.at) == PAUSED:
            self.clock.now += 1.0
        return super().publish(topic, payload, *args, **kwargs)


class Unknown:
    """In place of a LatestPose that heard nothing."""

    def newest(self, oldest: float) -> StampedPose:
        raise PoseUnknownError("twin/joint_states", math.inf, oldest)


@pytest.mark.parametrize("rate", [10.0, 25.0])
def test_a_view_is_published_once_a_period_and_what_a_pause_missed_is_left_out(monkeypatch, rate):
    clock = Clock()
    client = PausingClient(clock)
    monkeypatch.setattr(rospy, "is_shutdown", clock.over.is_set)
    monkeypatch.setattr(mqtt_planner, "time", SimpleNamespace(monotonic=lambda: clock.now, sleep=clock.sleep))
    monkeypatch.setattr(mqtt_planner, "now_ns", lambda: round(clock.now * NANOSECONDS))
    node = MqttPlanner(
        Settings(host="127.0.0.1", port=1, max_trajectory_bytes=4096, view_rate=rate),
        "kr120", JOINTS, Broker("127.0.0.1", 1), client, ViewWriter("kr120", "cafe", JOINTS), lambda **_: None, Refusals(None),
    )  # fmt: skip
    node.listen(Poses(Unknown(), Unknown()), lambda: False)
    node.run()
    views = [json.loads(payload) for topic, payload in client.published if topic == "twin/kr120/view"]
    assert [view["online"] for view in views] == [True] * VIEWS + [False]
    assert [view["seq"] for view in views[:-1]] == [views[0]["seq"] + k for k in range(VIEWS)]
    gaps = [later - before for before, later in zip(client.at, client.at[1:VIEWS])]
    expected = [1.0 / rate] * (VIEWS - 1)
    expected[PAUSED - 1] = 1.0
    assert gaps == pytest.approx(expected, abs=1e-6)
