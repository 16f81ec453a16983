"""What the gateway says, and when: one line per second and reason; the periodic status in the pause after an answer."""

from __future__ import annotations

import logging
from queue import SimpleQueue

from service_cell import cell

from construction_twin.gateway.command_line import WAITING, BoundedQueueHandler
from construction_twin.gateway.status import QUIET, StatusClock


def test_a_status_waits_for_an_answer_while_telegrams_come_and_for_nothing_without_a_controller():
    clock = StatusClock(1.0)
    assert clock.is_due(0.0, False)
    clock.sent(0.0)
    assert not clock.is_due(0.999, True) and not clock.is_due(1.001, False) and clock.is_due(1.003, True)
    # one out of turn puts the next one off
    clock.sent(1.9)
    assert not clock.is_due(2.5, True) and clock.is_due(2.9, True)
    clock.hurry()
    assert not clock.is_due(2.9 + QUIET / 2, False) and clock.is_due(2.9 + 2 * QUIET, False)


def line(number: int) -> logging.LogRecord:
    return logging.LogRecord("rsi_gateway", logging.WARNING, "", 0, "refused %d", (number,), None)


def test_a_log_that_nobody_reads_stays_bounded_and_says_later_what_is_missing():
    records: SimpleQueue = SimpleQueue()
    handler = BoundedQueueHandler(records)
    for number in range(WAITING + 5):
        handler.handle(line(number))
    assert (records.qsize(), handler.dropped) == (WAITING, 5)
    assert [records.get().getMessage() for _ in range(WAITING)][-1] == f"refused {WAITING - 1}"
    handler.handle(line(7))
    handler.handle(line(8))
    assert records.get().getMessage() == "refused 7 (5 lines before this one were dropped: they were not read)"
    assert records.get().getMessage() == "refused 8"


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
