"""The gateway's log, written beside its loop and bounded in memory. Standard library only."""

from __future__ import annotations

import logging
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue

#: Lines that may wait for a terminal or a pipe that takes none.
WAITING = 1000


class BoundedQueueHandler(QueueHandler):
    """Hands records to a thread; what comes while `WAITING` of them wait is dropped, and counted in the next line.

    A sender of garbage makes a line per message: neither memory nor the loop may pay for a log that nobody reads. The queue is one
    without a lock that another thread could hold.
    """

    def __init__(self, records: SimpleQueue):
        super().__init__(records)
        self.dropped = 0

    def enqueue(self, record: logging.LogRecord) -> None:
        """Put a record into the queue, or drop it."""
        if self.queue.qsize() >= WAITING:
            self.dropped += 1
            return
        if self.dropped:
            record.msg = f"{record.getMessage()} ({self.dropped} lines before this one were dropped: nobody read them)"
            record.args, self.dropped = None, 0
        self.queue.put_nowait(record)


def log_beside_the_loop() -> QueueListener:
    """Write the log from a thread of its own: the loop must not wait for a terminal or a full pipe (design, law 1).

    Returns
    -------
    listener : QueueListener
        Started; stop it at the end.
    """
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
    records: SimpleQueue = SimpleQueue()
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[BoundedQueueHandler(records)])
    listener = QueueListener(records, handler)
    listener.start()
    return listener
