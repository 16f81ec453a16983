"""`stop/<account>` between a real broker, a real UDP socket and the gateway; no ROS PC, no session."""

from __future__ import annotations

import json

import pytest
from processes import wait_until
from service_cell import PATIENT, START, assert_still, cell, motion, stream

pytestmark = pytest.mark.realtime


def answers(client, topics) -> list[dict]:
    return [json.loads(message.payload) for message in client.on(topics.stop_ack)]


def press(client, topics, payload: bytes, account: str = "arm-stopper-bob", retain: bool = False) -> dict:
    """Publish on `stop/<account>`; return the answer."""
    count = len(answers(client, topics))
    client.paho.publish(topics.stop_by(account), payload, qos=1, retain=retain)
    wait_until(lambda: len(answers(client, topics)) > count, what="an answer on stop/ack")
    return answers(client, topics)[count]


def test_a_stop_mid_motion_brakes_is_answered_and_names_who(broker, topics):
    with cell(broker, topics, config=PATIENT) as (service, controller, client):
        assert client.arm(PATIENT)["ok"]
        stream(client, controller, (motion(k) for k in range(150)))
        moving = controller.measured
        assert moving != START
        answer = press(client, topics, b'{"id": "7"}')
        assert answer == {
            "id": "7", "account": "arm-stopper-bob", "ok": True, "reason": "gateway is braking", "by": "gateway",
            "expired": False, "said": {"gateway is braking": {"template": "gateway is {state}", "values": {"state": "braking"}}},
        }  # fmt: skip
        # told before it is answered
        assert client.status()["state"] in ("braking", "holding")
        client.wait_for_status(state="holding", fault=True)
        assert client.status()["stop"]["by"] == "arm-stopper-bob"
        assert client.status()["reason"] == "stop: asked for by account arm-stopper-bob"
        assert_still(controller)
        assert not client.arm(PATIENT, "s2")["ok"]
        assert client.control("reset", session="s2")["ok"] and client.arm(PATIENT, "s2")["ok"]
