"""An append-only file of JSON objects, one per line, each chained to the one before; what has been appended is on the disk.

Every line carries the SHA-256 of the line before it in `previous`, so that an edited, removed or moved line breaks the chain. The
last line has no successor: compare its hash with one that was noted elsewhere, to find what was cut off, added or changed there.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, problem_of
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS

#: `previous` of the first line.
BEGIN = "0" * 64


@dataclass(frozen=True)
class LogState:
    """Number of lines of a chained file, and the SHA-256 (hex) of the last one; `BEGIN` without lines."""

    lines: int = 0
    head: str = BEGIN


def verify(path: str | Path) -> LogState:
    """Check a chained file from its first line to its last.

    Raises:
        ConfigurationError: Naming the first line that is not what it was when it was written, or a file that cannot be read.
    """
    content = read_whole(Path(path))
    lines = content.split(b"\n")
    if lines.pop():
        raise ConfigurationError(
            f"{path} line {len(lines) + 1}", "a line without an end", Sentence("expected.record.whole")
        )
    hashes = [BEGIN]
    for number, line in enumerate(lines, start=1):
        _check_line(path, number, line, hashes[-1])
        hashes.append(hashlib.sha256(line).hexdigest())
    return LogState(len(lines), hashes[-1])


def iso_time(now: int) -> str:
    """Return a time since 1970 [ns] in ISO 8601, UTC, with all nine decimals."""
    seconds, nanoseconds = divmod(now, NANOSECONDS)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"


def read_whole(path: Path) -> bytes:
    """Return a file's contents.

    Raises:
        ConfigurationError: If it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigurationError(str(path), problem_of(error), Sentence("expected.readable")) from error


class ChainedFile:
    """Appends to a chained file, which is created when it does not exist. Not for several threads at once.

    Args:
        failure: Takes the path and what is wrong; returns the error that is raised when a line cannot be appended.
        writer: Who else may be writing it, for the sentence: ``executor``.
        mend: A last line without its end was never reported as written (the power failed): it is cut off. By default it is refused.

    Attributes:
        mended: Bytes that were cut off.

    Raises:
        ConfigurationError: When the file cannot be written, another process writes it, or its chain is broken.
    """

    def __init__(
        self, path: str | Path, failure: Callable[[str, str], ConstructionTwinError], writer: str, mend: bool = False
    ):
        self.path = Path(path)
        self.mended = 0
        self._failure = failure
        self._file = _open(self.path, writer)
        try:
            if mend:
                self.mended = self._cut_torn_line()
            self._state = verify(self.path)
            self._size = os.fstat(self._file).st_size
        except (ConstructionTwinError, OSError):
            self.close()
            raise

    @property
    def state(self) -> LogState:
        """Number of lines, and the hash of the last one."""
        return self._state

    def append(self, now: int, fields: dict) -> None:
        """Write one line; when this returns it is on the disk.

        Args:
            now: Time since 1970 [ns].
            fields: What JSON can hold.

        Raises:
            ConstructionTwinError: What `failure` makes. What could be written of the line is taken back.
        """
        fields = {"time": iso_time(now), "time_ns": now} | fields | {"previous": self._state.head}
        line = json.dumps(fields, allow_nan=False).encode()
        state = LogState(self._state.lines + 1, hashlib.sha256(line).hexdigest())
        self._check_untouched()
        self._write(line + b"\n")
        self._state = state

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)

    def _check_untouched(self) -> None:
        """The file must be the one that was verified: not removed, replaced, cut or written to by another process."""
        try:
            there, here = os.stat(self.path), os.fstat(self._file)
        except OSError as error:
            raise self._failure(str(self.path), Sentence("reason.file.gone", problem=str(error))) from error
        if (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            raise self._failure(str(self.path), Sentence("reason.file.replaced"))
        if here.st_size != self._size:
            raise self._failure(
                str(self.path), Sentence("reason.file.other_writer", found=here.st_size, count=self._size)
            )

    def _write(self, data: bytes) -> None:
        try:
            written = os.write(self._file, data)
            if written != len(data):
                raise OSError(Sentence("reason.file.cut", written=written, count=len(data)))
            os.fsync(self._file)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise self._failure(str(self.path), str(error)) from error
        self._size += len(data)

    def _cut_torn_line(self) -> int:
        content = read_whole(self.path)
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.ftruncate(self._file, whole)
            os.fsync(self._file)
        return len(content) - whole


def _open(path: Path, writer: str) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
    except OSError as error:
        raise ConfigurationError(str(path), problem_of(error), Sentence("expected.writable")) from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        raise ConfigurationError(str(path), str(error), Sentence("expected.record.own", writer=writer)) from error
    return file


def _check_line(path: str | Path, number: int, line: bytes, previous: str) -> None:
    where = f"{path} line {number}"
    try:
        fields = json.loads(line)
    except ValueError as error:
        raise ConfigurationError(
            where, line[:80].decode(errors="replace"), Sentence("expected.record.object", problem=str(error))
        ) from error
    found = fields.get("previous") if isinstance(fields, dict) else None
    if found != previous:
        before = f"line {number - 1}" if number > 1 else "the beginning"
        raise ConfigurationError(where, found, Sentence("expected.record.hash", hash=previous, before=before))
