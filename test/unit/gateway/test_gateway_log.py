"""What the gateway says, and when: one line per second and reason; the periodic status in the pause after an answer."""

from __future__ import annotations

import logging
from types import SimpleNamespace

from service_cell import cell

from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.mqtt_connection import QUIET, MqttConnection


def test_a_status_waits_for_an_answer_while_telegrams_come_and_for_nothing_without_a_controller():
    second = NANOSECONDS
    side = SimpleNamespace(now=10 * second, _due_at=0, _received_at=0)

    def is_due(at, answered):
        side.now = round(at * second)
        return MqttConnection.is_status_due(side, answered)

    assert is_due(10.0, False)
    side._due_at = 11 * second
    assert not is_due(10.999, True) and not is_due(11.001, False) and is_due(11.003, True)
    side._due_at = 0
    quiet = QUIET / second
    assert not is_due(11.003 + quiet / 2, False) and is_due(11.003 + 2 * quiet, False)


def test_a_hostile_sender_makes_few_lines_and_repeats_make_none(broker, topics, caplog):
    caplog.set_level(logging.INFO, logger="rsi_gateway")
    with cell(broker, topics) as (service, controller, client):
        assert client.arm()["ok"]
        for _ in range(300):
            client.paho.publish(topics.control, b"rubbish", qos=1)
        client.wait_for_counter("refused_control", 300)
        lines = [record for record in caplog.records if "refused on control" in record.getMessage()]
        assert 1 <= len(lines) < 60
        assert client.control("speed_limit", 0.5)["ok"]
        answers, said = len(client.on(topics.control_ack)), len(caplog.records)
        for k in range(20):
            client.paho.publish(
                topics.control, f'{{"id": "{100 + k}", "session": "s1", "verb": "speed_limit", "value": 0.5}}', qos=1
            )
        # what was recorded of them: counted, and nothing else
        for _ in range(20):
            client.paho.publish(
                topics.control, '{"id": "2", "session": "s1", "verb": "speed_limit", "value": 1.0}', qos=1
            )
        assert not client.control("speed_limit", 2.0)["ok"]
        assert client.status()["counters"]["refused_repeated"] == 20
        assert len(client.on(topics.control_ack)) == answers + 1
        assert sum("speed_limit" in record.getMessage() for record in caplog.records[said:]) <= 1
