"""The gateway's stop, by `control` and by `stop/<account>`, is carried out and answered whatever fails beside it."""

from __future__ import annotations

import json

import pytest
from gateway_cell import Cell, following
from processes import wait_until
from service_cell import PATIENT, assert_still, cell, motion, stream

from construction_twin.core.rate_limit import SenderLimits
from construction_twin.gateway.control import Ownership
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.gateway.player import StopReport
from construction_twin.gateway.playout import Playout
from construction_twin.mqtt.messages import Intervention

WAYS = ("control", "account")


def fail(*_given, **_named):
    raise RuntimeError("nobody foresaw this")


def stop(gateway_cell: Cell, way: str) -> tuple[bool, str]:
    """Have the arm stopped; return whether it was, and the answer's words."""
    if way == "control":
        return gateway_cell.control("stop")
    answer = gateway_cell.gateway.on_stop(Intervention("arm-stopper-bob", "1"), gateway_cell.now)
    return answer.ok, answer.reason


@pytest.mark.parametrize(
    "owner, name, ways",
    [
        (StopReport, "begin", WAYS),
        (StopReport, "advance", WAYS),
        (SenderLimits, "admit", ("account",)),
        (Ownership, "is_repeated", ("control",)),
    ],
)
def test_what_predicts_or_counts_a_stop_cannot_fail_it(monkeypatch, owner, name, ways):
    for way in ways:
        arm = following()
        before = arm.measured
        with monkeypatch.context() as broken:
            broken.setattr(owner, name, fail)
            assert stop(arm, way) == (True, "gateway is braking")
            arm.cycle(400)
        assert arm.state is State.HOLDING and arm.gateway.fault and arm.measured != before
        status = arm.gateway.status()
        failed = {key: count for key, count in status["counters"].items() if key.startswith("failed_beside_")}
        # a stop asks nobody whether it came before
        assert (sum(failed.values()) > 0) is (owner is not Ownership)
        assert arm.control("reset", "s2")[0] and arm.arm("s2")[0]


def press(client, topics, way: str) -> dict:
    """Stop by the control topic or as a person; return the answer."""
    if way == "control":
        return client.control("stop")
    count = len(client.on(topics.stop_ack))
    client.paho.publish(topics.stop_by("arm-stopper-bob"), b'{"id": "7"}', qos=1)
    wait_until(lambda: len(client.on(topics.stop_ack)) > count, what="an answer on stop/ack")
    return json.loads(client.on(topics.stop_ack)[count].payload)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("owner, name", [(Playout, "status_fields"), (Gateway, "status")])
def test_a_status_that_cannot_be_made_fails_no_gateway_that_stops(broker, topics, monkeypatch, way, owner, name):
    with cell(broker, topics, config=PATIENT) as (service, controller, client):
        assert client.arm(PATIENT)["ok"]
        stream(client, controller, (motion(k) for k in range(60)))
        made, failed = getattr(owner, name), []

        def once_not(self, *given):
            if service.gateway.fault and not failed:
                failed.append(name)
                fail()
            return made(self, *given)

        monkeypatch.setattr(owner, name, once_not)
        assert press(client, topics, way)["ok"] and failed
        client.wait_for_status(state="holding", fault=True)
        wait_until(lambda: client.status()["counters"].get("failed_beside_the_status") == 1, what="the count")
        assert not service.failure
        assert_still(controller)
