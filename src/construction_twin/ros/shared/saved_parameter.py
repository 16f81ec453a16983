"""Saves a value on the parameter server for the process after this one, such as why the link waits for a person."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from construction_twin.core.units import NANOSECONDS

#: In the robot's namespace, not the node's own: there every name must be a setting. The launch file clears it.
PARAMETER = "stopped_session"
#: A write that failed is tried again after this time [ns].
_RETRY = NANOSECONDS


class SavedParameter:
    """A text, "" for nothing, or a bool on the parameter server, written by a thread that may wait; `fault`: why it was not."""

    def __init__(self, value: object, write: Callable[[Any], object], name: str = PARAMETER):
        self.fault = ""
        self._name = name
        self._write = write
        self._written = value
        self._writer: threading.Thread | None = None
        self._tried_at: int | None = None

    @property
    def writing(self) -> bool:
        """Whether a value is being written now."""
        return self._writer is not None and self._writer.is_alive()

    def save(self, value: object, now: int) -> None:
        """Save a value; returns at once. To be called again and again, from one thread, `now` in ns."""
        if value == self._written or self.writing:
            return
        if self._tried_at is not None and self.fault and now - self._tried_at < _RETRY:
            return
        self._tried_at = now
        self._writer = threading.Thread(target=self._write_value, args=(value,), daemon=True)
        self._writer.start()

    def _write_value(self, value: object) -> None:
        try:
            # XML-RPC takes a plain text only
            self._write(str(value) if isinstance(value, str) else value)
        except Exception as error:  # noqa: BLE001 (sockets, HTTP and XML-RPC raise kinds of their own; each is told and tried again)
            self.fault = f"{self._name} was not written, and what it says would not outlast this node ({error})"
            return
        self._written, self.fault = value, ""
