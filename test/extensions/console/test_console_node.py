"""The whole console node, from ROS topics and MQTT messages to MQTT messages and services, without ROS master and broker."""

from __future__ import annotations

import json
import threading
from types import SimpleNamespace

import pytest
import rospy
from bridge_bench import Client
from chain_samples import ROBOT
from construction_twin.msg import Execution, Plan, Review, Sync
from paho.mqtt.client import topic_matches_sub
from processes import wait_until
from unplugged import Unplugged

from construction_twin.extensions.console.nodes import console_node as module
from construction_twin.extensions.console.nodes.console_node import NODE, Settings
from construction_twin.ros.shared.diagnostics import OK, WARN

TOPIC = "twin/kr120/"
MOTION = {
    "id": "7", "units": {"angle": "rad", "length": "m", "time": "s"}, "joint_names": ROBOT.joint_names,
    "points": [{"positions": list(ROBOT.home)}, {"positions": [q + 0.1 for q in ROBOT.home]}],
}  # fmt: skip
VERDICT = {"plan_id": "p1", "plan_hash": "cafe", "verdict": "rejected", "reviewer": "Ann"}


class Line(Client):
    """In place of a client: remembers what is subscribed, and delivers messages as paho does."""

    def __init__(self):
        super().__init__()
        self.topics: list[str] = []
        self.callbacks: dict = {}
        self.on_connect = self.on_disconnect = None
        self.connected = False

    def subscribe(self, topics):
        self.topics += [topic for topic, *_ in topics]

    def message_callback_add(self, topic, callback):
        self.callbacks[topic] = callback

    def connect_async(self, *_):
        pass

    def loop_start(self):
        pass

    def loop_stop(self):
        pass

    def disconnect(self):
        self.connected = False

    def come_up(self):
        """Be connected, as paho tells it."""
        self.connected = True
        self.on_connect(self, None, None, SimpleNamespace(is_failure=False), None)

    def deliver(self, topic: str, document: object) -> None:
        message = SimpleNamespace(topic=TOPIC + topic, payload=json.dumps(document).encode(), retain=False)
        for pattern, callback in self.callbacks.items():
            if topic_matches_sub(pattern, message.topic):
                callback(self, None, message)

    def said(self, topic: str) -> list:
        """Return what was published on a topic."""
        return [
            json.loads(payload) if payload else None for name, payload in list(self.published) if name == TOPIC + topic
        ]


class Service:
    """In place of a service of another node, which says yes."""

    asked: list

    def __init__(self, name: str, kind: type, **_):
        self.resolved_name, self._response = f"/kr120/{name}", kind._response_class

    def __call__(self, **request):
        self.asked.append((self.resolved_name.removeprefix("/kr120/"), request))
        return self._response(success=True, message="done")

    def open(self):
        """Nothing is to be connected."""


@pytest.fixture
def bench(monkeypatch, tmp_path, request):
    """The node as `start` makes it, its connections, and what it asked of other nodes; the parameter is `view_rate`."""
    lines: list[Line] = []
    asked: list = []
    ended = threading.Event()

    def make_client(*_given, **_named) -> Line:
        lines.append(Line())
        return lines[-1]

    kind = type("Asked", (Service,), {"asked": asked})
    monkeypatch.setattr(module, "make_client", make_client)
    monkeypatch.setattr(module.rospy, "ServiceProxy", kind)
    monkeypatch.setattr(module, "PersistentService", kind)
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(rospy, "is_shutdown", ended.is_set)
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    rate = getattr(request, "param", 25.0)
    settings = Settings(host="127.0.0.1", port=1, max_trajectory_bytes=4096, view_rate=rate)
    unplugged = Unplugged(monkeypatch, NODE, settings, ROBOT, lambda *_: ROBOT.home)
    made = SimpleNamespace(acts=lines[0], line=lines[1], asked=asked, ended=ended, unplugged=unplugged)
    made.node, made.receive = unplugged.node, lambda topic, message: unplugged.callbacks[topic](message)
    yield made
    ended.set()


def test_what_people_do_has_a_connection_of_its_own(bench):
    assert bench.node.diagnose().level == WARN, "there is no connection yet"
    for line in (bench.acts, bench.line):
        line.come_up()
    assert bench.node.diagnose().level == OK
    acts = {
        "stop/+",
        "pause/+",
        "resume/+",
        "reset/+",
        "arm/+",
        "review",
        "review/+",
        "override_rehearsal/+",
        "answer/+",
        "lower_speed/+",
        "raise_speed/+",
    }
    assert set(bench.acts.topics) == {TOPIC + topic for topic in (*acts, "plan")}
    others = {"trajectory", "trajectory/from/+", "plan_request/+", "acknowledge/+"}
    assert set(bench.line.topics) == {TOPIC + topic for topic in others}
    assert bench.acts.said("plan") == [None] and bench.line.said("view")[0]["online"]
    bench.acts.connected = False
    assert bench.node.diagnose().level == WARN


def test_reports_and_requests_find_their_parts_and_an_end_takes_away_what_was_shown(bench):
    for line in (bench.acts, bench.line):
        line.come_up()
    running = threading.Thread(target=bench.node.run)
    running.start()
    bench.receive("plan", Plan(id="p1", hash="cafe"))
    bench.receive("sync", Sync(text="IN_SYNC"))
    bench.receive("execution", Execution(text="IDLE"))
    wait_until(lambda: bench.line.said("view")[-1]["plan"] == "p1", what="the plan in the view")
    view = bench.line.said("view")[-1]
    assert (view["sync"]["state"], view["twin"]["positions"]) == ("IN_SYNC", [pytest.approx(q) for q in ROBOT.home])
    bench.acts.deliver("stop/ada", {"id": "1"})
    bench.acts.deliver("review", VERDICT)
    bench.line.deliver("trajectory/from/ada", MOTION | {"id": "7"})
    wait_until(lambda: len(bench.asked) == 3, what="what was asked for")
    assert {name for name, _ in bench.asked} == {"executor/act_as_seen", "review_plan", "plan_trajectory"}
    wait_until(lambda: bench.line.said("trajectory/ack") and bench.acts.said("stop/ack"), what="the answers")
    assert bench.node.diagnose().values["stop taken"] == 1
    bench.receive("review", Review(plan_id="p1"))
    assert bench.acts.said("plan")[-1] is None
    bench.receive("plan", Plan(id="p2"))
    # a last will of an older connection, which came late, took it away
    plans = len(bench.acts.said("plan"))
    wait_until(lambda: len(bench.acts.said("plan")) > plans, what="the plan anew")
    bench.ended.set()
    running.join(10.0)
    assert bench.acts.said("plan")[-1] is None and bench.line.said("view")[-1]["online"] is False


@pytest.mark.parametrize("bench, rate", [(10.0, 10.0), (25.0, 25.0)], indirect=["bench"])
def test_a_view_is_published_once_a_period_and_what_a_pause_missed_is_left_out(bench, monkeypatch, rate):
    views, paused, now, at = 50, 20, [1000.0], []

    def publish_view() -> None:
        at.append(now[0])
        if len(at) == paused:
            # the machine pauses
            now[0] += 1.0
        if len(at) == views:
            bench.ended.set()

    def sleep(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr(bench.node.feed, "publish_view", publish_view)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))
    bench.node.run_view()
    expected = [1.0 / rate] * (views - 1)
    expected[paused - 1] = 1.0
    assert [later - before for before, later in zip(at, at[1:])] == pytest.approx(expected, abs=1e-6)
