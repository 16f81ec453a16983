"""The messages of a robot that a person must not miss: told in their order, kept in a file, acknowledged by MQTT."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

import genpy

from construction_twin.core.errors import ConfigurationError, RequestRefused
from construction_twin.core.files import read_file, write_whole
from construction_twin.core.reports import SpeedChange
from construction_twin.extensions.console.message_history import Message, MessageHistory
from construction_twin.extensions.console.nodes.endpoint import Connection, Incoming
from construction_twin.link.requests import Acknowledgement
from construction_twin.mqtt.requests import ACKNOWLEDGE
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.views.status_line import Line

#: Largest file that is read [bytes].
MOST = 4 << 20
#: As what it is counted that the file cannot be read or written.
REASON = "messages"


class MessageBoard:
    """A `MessageHistory` for several threads.

    Args:
        tell: Takes the messages as JSON: at the first look, and after each change.
        connection: By which they are acknowledged; counts a file that cannot be read or written.
        file: Where they are kept; None: only in memory.
        clock: Returns the time of day [s since 1970].
    """

    def __init__(
        self,
        tell: Callable[[bytes], object],
        connection: Connection,
        file: Path | None = None,
        clock: Callable[[], float] = time.time,
    ):
        self._tell, self._refuse, self._file, self._clock = tell, connection.refuse, file, clock
        # held while it is told: what is retained must not be an older one, told by another thread
        self._lock = threading.Lock()
        self._history = MessageHistory(lambda: uuid.uuid4().hex)
        if file is not None:
            try:
                self._history = MessageHistory(lambda: uuid.uuid4().hex, read_file(file, MOST))
            except FileNotFoundError:
                pass
            except (OSError, ConfigurationError) as error:
                self._refuse(REASON, f"{file}: {error}; the messages begin anew")
        self._told: tuple[Message, ...] | None = None
        self._written = self._history.messages
        connection.serve(ACKNOWLEDGE, Acknowledgement, self._acknowledge)

    def on_lines(self, lines: Sequence[Line]) -> None:
        """Take the status line as it is now."""
        with self._lock:
            self._history.on_lines(lines, self._clock())
            self._publish()

    def on_act(self, act: str, at: genpy.Time, sentence: str) -> None:
        """Take what a person did, as `MessageHistory.on_act`."""
        with self._lock:
            self._history.on_act(act, at.to_sec(), sentence)
            self._publish()

    def on_speed(self, change: SpeedChange) -> None:
        """Take that a person has set the speed limit, as `MessageHistory.on_speed`."""
        with self._lock:
            self._history.on_speed(change)
            self._publish()

    def write(self) -> None:
        """Write the file where something has changed, for a thread that may wait for a disk."""
        with self._lock:
            if self._written is self._history.messages:
                return
            self._written, text = self._history.messages, self._history.text
        if self._file is not None:
            try:
                write_whole(self._file, text)
            except OSError as error:
                self._refuse(REASON, f"{self._file} was not written: {error.strerror or error}")

    def _acknowledge(self, asked: Acknowledgement, request: Incoming) -> Outcome:
        try:
            with self._lock:
                sentence = self._history.acknowledge(asked.message, request.account, self._clock())
                self._publish()
        except RequestRefused as error:
            return Outcome(False, str(error))
        return Outcome(True, sentence)

    def _publish(self) -> None:
        if self._told is not self._history.messages:
            self._told = self._history.messages
            self._tell(self._history.text)
