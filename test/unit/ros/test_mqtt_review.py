"""The node that shows plans and takes verdicts on MQTT, without ROS master and broker."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
import rospy
from bridge_bench import Client, Refusals
from rospy.exceptions import TransportTerminated

from construction_twin.link.remote_review import RemoteReview
from construction_twin.mqtt.client import Broker
from construction_twin.ros.nodes.mqtt_review import WAITING, MqttReview, Settings


class Bench:
    """The node, a client that remembers, and an executor that says yes."""

    def __init__(self):
        self.client = Client()
        self.made = None

        def make(report):
            self.made = Refusals(report)
            return self.made

        settings = Settings(host="127.0.0.1", port=1, path_points=10)
        self.node = MqttReview(settings, "kr120", Broker("127.0.0.1", 1), self.client, self, make)

    resolved_name = "/kr120/review_plan"

    error: Exception | None = None

    def __call__(self, *request):
        if self.error is not None:
            raise self.error
        return SimpleNamespace(success=True, message="approved")

    def verdict(self, plan="p1"):
        """A message on `review`."""
        content = {"plan_id": plan, "plan_hash": "cafe", "verdict": "approved", "reviewer": "Ann"}
        self.node.on_review(json.dumps(content).encode(), False)


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    return Bench()


def test_more_verdicts_than_may_wait_are_refused_counted_and_answered(bench):
    bench.node.on_review(b"{", False)
    for _ in range(WAITING + 2):
        bench.verdict()
    answers = [json.loads(payload) for topic, payload in bench.client.published if topic.endswith("/ack")]
    assert bench.made.refused == {"review": 1, "busy": 2} and [answer["ok"] for answer in answers] == [False] * 3


@pytest.mark.parametrize("error", [TransportTerminated("x"), ConnectionResetError("x"), rospy.ServiceException("x")])
def test_an_executor_that_goes_away_during_the_call_is_told(bench, error):
    bench.error = error
    bench.node.carry_out(RemoteReview("p1", "cafe", "approved", "Ann", ""))
    answer = json.loads(bench.client.published[-1][1])
    assert not answer["ok"] and "/kr120/review_plan does not answer: x" in answer["reason"]


def test_a_verdict_that_was_carried_out_is_answered_and_counted(bench):
    bench.node.carry_out(RemoteReview("p1", "cafe", "approved", "Ann", ""))
    assert json.loads(bench.client.published[-1][1])["ok"]
    assert bench.node.report().values == {"verdicts taken": 1}
