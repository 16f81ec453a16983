"""The gateway's log, written beside its loop and bounded in memory. Standard library only."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue

from construction_twin.core.units import NANOSECONDS

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


@dataclass(frozen=True, slots=True)
class _Written:
    """When a line was written last [ns], and how many of its kind were left out since."""

    at: int
    left_out: int = 0


class LineLimiter:
    """At most one line per reason and period: a sender of rubbish must neither fill the disk nor hide other lines.

    Args:
        period: [ns]
    """

    def __init__(self, period: int = NANOSECONDS):
        self._period = period
        self._lines: dict[str, _Written] = {}

    def note(self, reason: str, now: int) -> str | None:
        """Take a line that is to be written at `now` [ns].

        Args:
            reason: Its kind: one of few, never text that came from outside, because every kind is remembered.
            now: [ns]

        Returns:
            What to append to the line, "" or how many like it were left out before; None when it must not be written.
        """
        last = self._lines.get(reason, _Written(now - self._period))
        if now - last.at < self._period:
            self._lines[reason] = _Written(last.at, last.left_out + 1)
            return None
        self._lines[reason] = _Written(now)
        return f" ({last.left_out} more like this since the last such line)" if last.left_out else ""
