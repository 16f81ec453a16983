"""The gateway's log, written beside its loop and bounded in memory. Standard library only."""

from __future__ import annotations

import logging
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue

#: Lines that may wait for a terminal or a pipe that takes none.
WAITING = 1000


class BoundedQueueHandler(QueueHandler):
    """Hands records to a thread; what comes while `WAITING` of them wait is dropped, and counted in the next line.

    A sender of garbage makes a line per message: neither memory nor the loop may pay for a log that is not read. The queue is one
    without a lock that another thread could hold.
    """

    def __init__(self, records: SimpleQueue):
        super().__init__(records)
        self._records = records
        self.dropped = 0

    def enqueue(self, record: logging.LogRecord) -> None:
        """Put a record into the queue, or drop it."""
        if self._records.qsize() >= WAITING:
            self.dropped += 1
            return
        if self.dropped:
            record.msg = (
                f"{record.getMessage()} ({self.dropped} lines before this one were dropped: they were not read)"
            )
            record.args, self.dropped = None, 0
        self._records.put_nowait(record)


def log_beside_the_loop() -> QueueListener:
    """Write the log from a thread of its own: the loop must not wait for a terminal or a full pipe (docs/architecture.md, law 1).

    Returns:
        Started; stop it at the end.
    """
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
    records: SimpleQueue = SimpleQueue()
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[BoundedQueueHandler(records)])
    listener = QueueListener(records, handler)
    listener.start()
    return listener
