"""The transition log: a file of the monitor's changes of state, one JSON object per line, only ever added to.

Values in rad, m for prismatic joints; times in ns since 1970.
"""

from __future__ import annotations

import json
import math
import os
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, TransitionLogError
from construction_twin.core.sentences import Sentence
from construction_twin.monitor.states import Transition
from construction_twin.review.chained_file import iso_time

#: Transitions kept while the disk refuses them; older ones are counted and forgotten.
KEPT = 1000


def transition_fields(change: Transition, names: Sequence[str]) -> dict:
    """Return what a line of the log holds of a transition, for these joint names; `error` and `threshold` by joint."""
    last = change.comparison
    return {
        "time": iso_time(change.at),
        "time_ns": change.at,
        "from": change.source.name,
        "to": change.target.name,
        "event": change.event.value,
        "reason": change.reason,
        "error": _by_joint(names, last.error) if last else {},
        "threshold": _by_joint(names, last.threshold) if last else {},
        "held_stamp_ns": change.held_stamp,
    }


def _by_joint(names: Sequence[str], values: Sequence[float]) -> dict[str, float | None]:
    """Return values by joint name; JSON has no word for what is no number."""
    return {name: value if math.isfinite(value) else None for name, value in zip(names, values)}


class TransitionLog:
    """Appends transitions to a file, which is created when it does not exist; for use from several threads.

    Args:
        path: ``~`` is the home folder.
        names: Joint names.

    Attributes:
        written: Transitions written since the start.
        lost: Transitions that could not be kept until the file could be written.

    Raises:
        ConfigurationError: When the file cannot be written.
    """

    def __init__(self, path: str | Path, names: Sequence[str]):
        self.path = Path(path).expanduser()
        self.written = self.lost = 0
        self._names = tuple(names)
        self._lock = threading.Lock()
        self._deferred: deque[Transition] = deque()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
        except OSError as error:
            raise ConfigurationError(str(self.path), str(error), Sentence("expected.transition_log")) from error
        # a monitor that was killed while it wrote left half a line behind
        size = os.fstat(self._file).st_size
        self._begin = b"\n" if size and os.pread(self._file, 1, size - 1) != b"\n" else b""

    def defer(self, change: Transition) -> None:
        """Keep a transition for the next `flush`; does not touch the disk."""
        if len(self._deferred) >= KEPT:
            self._deferred.popleft()
            self.lost += 1
        self._deferred.append(change)

    def flush(self) -> None:
        """Write what was deferred.

        Raises:
            TransitionLogError: When it cannot be; what is not written stays deferred.
        """
        with self._lock:
            while self._deferred:
                change = self._deferred[0]
                line = json.dumps(transition_fields(change, self._names), allow_nan=False).encode()
                self._write(self._begin + line + b"\n")
                self.written += 1
                if self._deferred and self._deferred[0] is change:
                    self._deferred.popleft()

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)

    def _write(self, data: bytes) -> None:
        try:
            written = os.write(self._file, data)
        except OSError as error:
            raise TransitionLogError(str(self.path), str(error)) from error
        if written != len(data):
            self._begin = b"\n"
            raise TransitionLogError(str(self.path), Sentence("reason.file.cut", written=written, count=len(data)))
        self._begin = b""
