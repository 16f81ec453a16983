"""An unexpected exception, raised in every part of the running gateway: it brakes, answers, says so, and stays failed."""

from __future__ import annotations

import linecache
import logging
import threading
import time

import pytest
from processes import wait_until
from service_cell import CONFIG, PATIENT, cell, motion, stream

from construction_twin.core.follower import Follower
from construction_twin.core.units import CYCLE
from construction_twin.gateway.states import State

pytestmark = pytest.mark.realtime


class Unexpected(Exception):
    """What no handler of the package names."""


def broken(*arguments, **options):
    raise Unexpected("injected")


def broken_once(original):
    """Raise in the first call only: what sends the replies is what the last resort needs, too."""
    calls = []

    def broken(*arguments):
        calls.append(arguments)
        if len(calls) == 1:
            raise Unexpected("injected")
        return original(*arguments)

    return broken


#: Part of the service and name of the method that begins to raise in motion, and how many replies may be missing.
PARTS = {
    "inbox": lambda service: (service.controller.inbox, "newest"),
    "telegram decoder": lambda service: (service.controller.inbox, "parse"),
    "controller session": lambda service: (service.gateway.controller, "on_telegram"),
    "playout": lambda service: (service.gateway.player.playout, "advance"),
    # the class: a reply that did not arrive places another follower, at rest where the arm stands
    "follower": lambda service: (Follower, "follow"),
    "reply's encoder": lambda service: (service.controller.encoder, "encode"),
    "reply's socket": lambda service: (service.controller, "_send"),
    "state publisher": lambda service: (service.mqtt.polled.client, "send_stream"),
    "state's codec": lambda service: (service.gateway.codec, "encode"),
    "status": lambda service: (service.gateway, "status"),
    "status publisher": lambda service: (service.mqtt.polled.client, "publish"),
    "status clock": lambda service: (service.mqtt, "is_status_due"),
    "histogram": lambda service: (service.controller.reply_time, "add"),
    "poll": lambda service: (service.gateway, "poll"),
    "command callback": lambda service: (service.gateway, "on_command"),
    "command's codec": lambda service: (service.gateway.intake.stream, "read"),
    "MQTT connection": lambda service: (service.mqtt.polled, "service"),
    "MQTT reading": lambda service: (service.mqtt.polled, "read"),
    "MQTT library": lambda service: (service.mqtt.polled.client, "loop_read"),
    "selector": lambda service: (service._selector, "select"),
}
#: Parts without which nothing can be said on MQTT any more: the log says it.
MUTE = {"status publisher", "MQTT connection"}


def assert_it_brakes_and_holds(controller, begin, missed=1):
    """Every reply from `begin` on is there, inside the acceleration limits, and ends at rest away from where it was."""
    wait_until(lambda: len(controller.replies) > begin + 250, what="a second of replies")
    replies = controller.replies[begin - 2 :]
    assert sum(reply is None for reply in replies) <= missed
    places = [reply for reply in replies if reply is not None]
    for axis, acceleration in enumerate(CONFIG.acceleration):
        values = [place[axis] for place in places]
        changes = [abs(c - 2 * b + a) for a, b, c in zip(values, values[1:], values[2:])]
        # what the command's three decimals add is the format's allowance
        assert max(changes) <= (acceleration * CYCLE**2) * 1.0001 + 4e-5
    assert places[-1] == places[-2] == places[-20]


@pytest.mark.parametrize("part", PARTS)
def test_the_arm_brakes_is_held_and_a_person_is_asked_for(part, broker, topics, caplog, monkeypatch):
    with (
        caplog.at_level(logging.CRITICAL, "rsi_gateway"),
        cell(broker, topics, config=PATIENT) as (service, controller, client),
    ):
        assert client.arm(PATIENT)["ok"]
        stream(client, controller, (motion(k) for k in range(80)))
        assert service.gateway.state is State.FOLLOWING
        owner, name = PARTS[part](service)
        begin = len(controller.replies)
        fault = broken_once(getattr(owner, name)) if part == "reply's socket" else broken
        monkeypatch.setattr(owner, name, fault)
        for k in range(80, 100):
            client.command(motion(k))
            time.sleep(0.004)
        wait_until(lambda: service.gateway.state is not State.FOLLOWING, what="the failure")
        assert service.gateway.state is State.FAILED, service.gateway.reason
        assert "Unexpected: injected" in service.failure
        assert_it_brakes_and_holds(controller, begin)
        assert service.gateway.fault
        said = [record for record in caplog.records if record.levelno == logging.CRITICAL]
        assert len(said) == 1 and said[0].exc_info[0] is Unexpected
        if part not in MUTE:
            status = client.wait_for_status(state="failed") and client.status()
            assert status["fault"] and "start it again" in status["reason"] and status["run"] == service.gateway.run
        if part not in MUTE | {"MQTT reading", "MQTT library"}:
            for verb in ("reset", "arm"):
                answer = client.arm(PATIENT, "s2") if verb == "arm" else client.control(verb)
                assert not answer["ok"] and "failed" in answer["reason"]
        assert len([record for record in caplog.records if record.levelno == logging.CRITICAL]) == 1
        if part == "telegram decoder":
            # the pose is still told: another decoder reads it
            told = len(client.on(topics.state))
            wait_until(lambda: len(client.on(topics.state)) > told + 20, what="states")


def test_a_slow_disk_and_a_broken_state_machine_hold_no_reply_up(broker, topics, caplog, monkeypatch):
    """The sentence, the state and the log line come after the reply, and the traceback is formatted elsewhere."""
    looked_up = []

    def slow(*_):
        looked_up.append(threading.current_thread())
        time.sleep(0.1)
        return []

    monkeypatch.setattr(linecache, "getlines", slow)
    monkeypatch.setattr(linecache, "checkcache", slow)
    with (
        caplog.at_level(logging.CRITICAL, "rsi_gateway"),
        cell(broker, topics, config=PATIENT) as (service, controller, client),
    ):
        assert client.arm(PATIENT)["ok"]
        stream(client, controller, (motion(k) for k in range(80)))
        begin = len(controller.replies)
        service.gateway.fail = broken
        service.gateway.player.playout.advance = broken
        assert_it_brakes_and_holds(controller, begin)
        assert "injected" in service.failure and service.gateway.counters["failures"] >= 2
        assert client.wait_for_status(state="failed")
    assert looked_up


def test_a_failure_is_told_behind_the_answer_that_is_owed(broker, topics):
    with cell(broker, topics, config=PATIENT) as (service, controller, client):
        assert client.arm(PATIENT)["ok"]
        stream(client, controller, (motion(k) for k in range(40)))
        order, answer, fail = [], service.controller.answer_as_last_resort, service.gateway.fail
        service.controller.answer_as_last_resort = lambda: (order.append("answer"), answer())[1]
        service.gateway.fail = lambda reason: (order.append("failure"), fail(reason))
        service.gateway.player.playout.advance = broken
        wait_until(lambda: "failure" in order, what="the failure")
    assert order[0] == "answer"
