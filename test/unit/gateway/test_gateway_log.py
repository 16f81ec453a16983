"""What the gateway says, and when: one line per second and reason; the periodic status in the pause after an answer."""

from __future__ import annotations

import logging

from service_cell import cell

from construction_twin.gateway.status import QUIET, StatusClock


class TestStatusClock:
    def test_waits_for_an_answer_while_telegrams_come(self):
        clock = StatusClock(1.0)
        clock.sent(0.0)
        assert not clock.is_due(0.999, True)
        assert not clock.is_due(1.001, False)
        assert clock.is_due(1.003, True)

    def test_is_sent_without_a_controller(self):
        clock = StatusClock(1.0)
        assert clock.is_due(0.0, False)
        clock.sent(0.0)
        assert not clock.is_due(0.5, True)
        assert not clock.is_due(1.0, False) or QUIET <= 0.5
        assert clock.is_due(1.2, False)

    def test_a_status_out_of_turn_puts_the_next_one_off(self):
        clock = StatusClock(1.0)
        clock.sent(0.0)
        clock.sent(0.9)
        assert not clock.is_due(1.5, True) and clock.is_due(1.9, True)


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
