"""The gateway's log: bounded, whatever is thrown at it."""

from __future__ import annotations

import logging
from queue import SimpleQueue

from construction_twin.gateway.command_line import WAITING, BoundedQueueHandler


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
