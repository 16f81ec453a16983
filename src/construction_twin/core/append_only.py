"""An append-only file of JSON objects, one per line: verdicts, the ledger of the work, the monitor's changes of state."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import threading
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, system_message
from construction_twin.core.units import NANOSECONDS

#: Deferred lines that are kept while the file cannot be written; what comes then is counted, and the number is written later.
MAX_DEFERRED = 1000


def iso_time(now: int) -> str:
    """Return a time since 1970 [ns] in ISO 8601, UTC, with all nine decimals."""
    seconds, nanoseconds = divmod(now, NANOSECONDS)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"


def read_lines(path: str | Path) -> list[dict]:
    """Return the complete lines of a file that another process may be writing."""
    content = _read(Path(path))
    lines = []
    for number, line in enumerate(content[: content.rfind(b"\n") + 1].split(b"\n")[:-1], start=1):
        try:
            fields = json.loads(line)
            if not isinstance(fields, dict):
                raise ValueError(type(fields).__name__)
        except ValueError as error:
            found = line[:80].decode(errors="replace")
            expected = f"a JSON object ({error})"
            raise ConfigurationError(f"{path} line {number}", found, expected) from error
        lines.append(fields)
    return lines


class AppendOnlyFile:
    """Appends lines to a file, from several threads; a last line without its end (power failure) is cut off at the start.

    `failure` takes the path and what is wrong, and returns the error to raise. `lost`: deferred lines dropped beyond
    `MAX_DEFERRED`.
    """

    def __init__(self, path: str | Path, failure: Callable[[str, str], ConstructionTwinError], writer: str):
        self.path = Path(path).expanduser()
        # `defer` counts the one, `flush` the other: they are called from two threads
        self.lost = self._reported = 0
        self._failure = failure
        self._lock = threading.Lock()
        self._deferred: deque[tuple[int, dict]] = deque()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
        except OSError as error:
            raise ConfigurationError(str(self.path), system_message(error), "a file that can be written") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            content = _read(self.path)
            self.lines, self._size = content.count(b"\n"), content.rfind(b"\n") + 1
            self.cut_off = len(content) - self._size
            if self.cut_off:
                os.ftruncate(self._file, self._size)
                os.fsync(self._file)
        except (ConfigurationError, OSError) as error:
            self.close()
            if isinstance(error, ConfigurationError):
                raise
            raise ConfigurationError(str(self.path), str(error), f"a file that no other {writer} writes") from error

    def defer(self, now: int, fields: dict) -> None:
        """Queue a line with its time since 1970 [ns] for `flush`."""
        if len(self._deferred) >= MAX_DEFERRED:
            # no verdict is taken meanwhile: `append` writes these first, and fails
            self._lost_at = now
            self.lost += 1
            return
        self._deferred.append((now, fields))

    def flush(self) -> None:
        """Write queued lines; on error they stay queued."""
        with self._lock:
            while self._deferred:
                self._append(*self._deferred[0])
                self._deferred.popleft()
            number = self.lost - self._reported
            if number:
                reason = f"the file could not be written, and {MAX_DEFERRED} records waited already"
                self._append(self._lost_at, {"record": "gap", "lost": number, "reason": reason})
                self._reported += number

    def append(self, now: int, fields: dict) -> None:
        """Write queued lines, then this one, to the disk; on error nothing of it remains."""
        self.flush()
        with self._lock:
            self._append(now, fields)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def _append(self, now: int, fields: dict) -> None:
        data = json.dumps({"time": iso_time(now), "time_ns": now} | fields, allow_nan=False).encode() + b"\n"
        self._check_in_place()
        try:
            written = os.write(self._file, data)
            if written != len(data):
                raise OSError(f"only {written} of {len(data)} bytes could be written")
            os.fsync(self._file)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise self._failure(str(self.path), str(error)) from error
        self._size += len(data)
        self.lines += 1

    def _check_in_place(self) -> None:
        """Check that the file is still the one that was opened."""
        try:
            there, here = os.stat(self.path), os.fstat(self._file)
        except OSError as error:
            problem = f"the file is gone ({error}): put it back, or start its node again, which begins another one"
            raise self._failure(str(self.path), problem) from error
        if (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            problem = "the file was replaced by another: put it back, or start its node again, which checks it"
            raise self._failure(str(self.path), problem)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigurationError(str(path), system_message(error), "a file that can be read") from error
