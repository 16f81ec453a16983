"""The review record: a file of verdicts and of what became of them, one JSON object per line, each chained to the one before.

Every line carries the SHA-256 of the line before it in `previous`, so that an edited, removed or moved line breaks the chain. The
last line has no successor: compare its hash with one that was noted elsewhere, to find what was cut off, added or changed there.
Durations in s, distances in m.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import hashlib
import json
import math
import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RecordError
from construction_twin.core.units import NANOSECONDS
from construction_twin.review.queue import APPROVED, Ending, Verdict
from construction_twin.robot.plan import Plan

#: `previous` of the first line.
BEGIN = "0" * 64
#: Records that are kept while the file cannot be written; what comes then is counted, and the number is recorded later.
KEPT = 1000


@dataclass(frozen=True)
class LogState:
    """Number of lines of a review file, and the SHA-256 (hex) of the last one; `BEGIN` without lines."""

    lines: int = 0
    head: str = BEGIN


def verify(path: str | Path) -> LogState:
    """Check a review file from its first line to its last.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    state : LogState

    Raises
    ------
    ConfigurationError
        Naming the first line that is not what it was when it was written, or a file that cannot be read.
    """
    content = _read(Path(path))
    lines = content.split(b"\n")
    if lines.pop():
        raise ConfigurationError(
            f"{path} line {len(lines) + 1}", "a line without an end", "complete lines; the file was cut"
        )
    hashes = [BEGIN]
    for number, line in enumerate(lines, start=1):
        _check_line(path, number, line, hashes[-1])
        hashes.append(hashlib.sha256(line).hexdigest())
    return LogState(len(lines), hashes[-1])


@dataclass(frozen=True)
class Responsibility:
    """A bare PLC was armed by a person, who is responsible for what is not checked; see docs/broker.md.

    Attributes
    ----------
    name : str
        Of the person.
    session : str
        Id of the command session that it is for.
    not_checked : tuple of str
    """

    name: str
    session: str
    not_checked: tuple[str, ...]


#: What is recorded.
Record = Verdict | Ending | Responsibility


@dataclass(frozen=True)
class _Deferred:
    """A record that waits for the disk: when it was made, UTC [ns], and whose responsibility was in force then."""

    time: int
    record: Record
    responsibility: Responsibility | None


class ReviewLog:
    """Appends records to a review file, which is created when it does not exist; for use from several threads.

    Parameters
    ----------
    path : str or Path
        ``~`` is the home folder.
    clock : callable
        Returns the time since 1970 in UTC [ns].

    Attributes
    ----------
    responsibility : Responsibility or None
        What is in force; it is recorded with every verdict.
    lost : int
        Deferred records that were not kept, because `KEPT` others waited for a file that could not be written.

    Raises
    ------
    ConfigurationError
        When the path is empty, the file cannot be written, another process writes it, or its chain is broken.
    RecordError
        When the record of an execution that had no end cannot be written.
    """

    def __init__(self, path: str | Path, clock: Callable[[], int]):
        if not str(path).strip():
            raise ConfigurationError(
                "review file", str(path), "the path of a file: nothing is approved without a record"
            )
        self.path = Path(path).expanduser()
        self._clock = clock
        self._lock = threading.Lock()
        self._deferred: deque[_Deferred] = deque()
        self.responsibility: Responsibility | None = None
        # `defer` counts the one, `flush` the other: they are called from two threads
        self.lost = self._told = 0
        self._file = _open(self.path)
        try:
            self._state = verify(self.path)
            self._size = os.fstat(self._file).st_size
            self._end_interrupted()
        except ConstructionTwinError:
            self.close()
            raise

    @property
    def state(self) -> LogState:
        """Number of lines, and the hash of the last one."""
        return self._state

    def defer(self, record: Record) -> None:
        """Keep a record for the next `flush`, with the present time; does not touch the disk."""
        if len(self._deferred) >= KEPT:
            # no verdict is taken meanwhile: `append` writes these first, and fails
            self.lost += 1
            return
        self._deferred.append(_Deferred(self._clock(), record, self.responsibility))

    def flush(self) -> None:
        """Write what was deferred.

        Raises
        ------
        RecordError
            When it cannot be; what is not written stays deferred.
        """
        with self._lock:
            while self._deferred:
                first = self._deferred[0]
                self._append(first.time, _fields(first.record, first.responsibility))
                self._deferred.popleft()
            number = self.lost - self._told
            if number:
                reason = f"the file could not be written, and {KEPT} records waited already"
                self._append(self._clock(), {"record": "gap", "lost": number, "reason": reason})
                self._told += number

    def append(self, record: Record) -> None:
        """Write one record, behind those that were deferred; when this returns it is on the disk.

        Raises
        ------
        RecordError
            When it is not. What could be written of it is taken back.
        """
        self.flush()
        with self._lock:
            self._append(self._clock(), _fields(record, self.responsibility))

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)

    def _end_interrupted(self) -> None:
        """Record the end of an execution whose executor ended first: a restarted one never goes on with it."""
        last = _execution_without_end(_read(self.path))
        if last is not None:
            reason = "the executor ended before the execution did"
            fields = {
                "record": "execution",
                "outcome": "dropped",
                "plan": last["plan"],
                "trajectory": last["trajectory"],
            }
            self._append(self._clock(), fields | {"scene": last["scene"], "reason": reason})

    def _append(self, now: int, fields: dict) -> None:
        fields = {"time": iso_time(now), "time_ns": now} | fields | {"previous": self._state.head}
        line = json.dumps(fields, allow_nan=False).encode()
        state = LogState(self._state.lines + 1, hashlib.sha256(line).hexdigest())
        self._check_untouched()
        self._write(line + b"\n")
        self._state = state

    def _check_untouched(self) -> None:
        """The file must be the one that was verified: not removed, replaced, cut or written to by another process."""
        try:
            there, here = os.stat(self.path), os.fstat(self._file)
        except OSError as error:
            raise RecordError(str(self.path), f"the file is gone ({error})") from error
        if (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            raise RecordError(str(self.path), "the file was replaced by another")
        if here.st_size != self._size:
            raise RecordError(
                str(self.path), f"the file has {here.st_size} bytes, not {self._size}: another process wrote to it"
            )

    def _write(self, data: bytes) -> None:
        try:
            written = os.write(self._file, data)
            if written != len(data):
                raise OSError(f"only {written} of {len(data)} bytes could be written")
            os.fsync(self._file)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise RecordError(str(self.path), str(error)) from error
        self._size += len(data)


def main(arguments: list[str] | None = None) -> int:
    """Check the review file named on the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="review_log", description="Check the chain of a review file.")
    parser.add_argument("file", type=Path, help="review file, e.g. ~/.ros/construction_twin/kr120_reviews.jsonl")
    options = parser.parse_args(arguments)
    try:
        state = verify(options.file)
    except ConfigurationError as error:
        print(f"review_log: {error}", file=sys.stderr)
        return 1
    print(f"{options.file}: {state.lines} records, none changed; the last one's SHA-256 is {state.head}")
    return 0


# -- records


def _fields(record: Record, responsibility: Responsibility | None) -> dict:
    if isinstance(record, Responsibility):
        return {"record": "responsibility", "session": record.session} | _responsibility_fields(record)
    if isinstance(record, Ending):
        named = {
            "record": "execution",
            "outcome": record.outcome,
            "plan": record.plan.id,
            "trajectory": record.plan.hash,
        }
        return named | {"scene": record.plan.scene, "reason": record.reason}
    trajectory = record.plan_hash if record.plan is None else record.plan.hash
    named = {"record": "verdict", "verdict": record.verdict, "plan": record.plan_id, "trajectory": trajectory}
    named |= {"reviewer": record.reviewer, "reason": record.reason}
    return named | _responsibility_fields(responsibility) | _plan_fields(record.plan)


def _responsibility_fields(responsibility: Responsibility | None) -> dict:
    """Return who is responsible for what is not checked; nothing where a gateway checks it."""
    if responsibility is None:
        return {}
    return {"responsible": responsibility.name, "not_checked": list(responsibility.not_checked)}


def _plan_fields(plan: Plan | None) -> dict:
    """Return what a reader of the record wants to know of the plan; nothing when it was unknown."""
    if plan is None:
        return {}
    clearance = plan.report.clearance
    return {
        "scene": plan.scene,
        "source": plan.source,
        "planner": plan.planner,
        "duration": plan.trajectory.duration,
        "clearance": _number(clearance.distance),
        "clearance_between": list(clearance.between),
        "clearance_time": _number(clearance.time),
    }


def _number(value: float) -> float | None:
    """Return what JSON can hold: None for a distance that is infinite because there is nothing to touch."""
    return value if math.isfinite(value) else None


def _execution_without_end(content: bytes) -> dict | None:
    """Return the last approval if no end of its execution is recorded after it."""
    last = None
    for fields in map(json.loads, content.splitlines()):
        if fields.get("verdict") == APPROVED:
            last = fields
        elif last is not None and fields.get("record") == "execution" and fields.get("plan") == last["plan"]:
            last = None
    return last


def iso_time(now: int) -> str:
    """Return a time since 1970 [ns] in ISO 8601, UTC, with all nine decimals."""
    seconds, nanoseconds = divmod(now, NANOSECONDS)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"


# -- files


def _open(path: Path) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
    except OSError as error:
        raise ConfigurationError(str(path), str(error), "a file that can be written") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        raise ConfigurationError(str(path), str(error), "a file that no other executor writes") from error
    return file


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigurationError(str(path), str(error), "a readable review file") from error


def _check_line(path: str | Path, number: int, line: bytes, previous: str) -> None:
    where = f"{path} line {number}"
    try:
        fields = json.loads(line)
    except ValueError as error:
        raise ConfigurationError(where, line[:80].decode(errors="replace"), f"a JSON object ({error})") from error
    found = fields.get("previous") if isinstance(fields, dict) else None
    if found != previous:
        before = f"line {number - 1}" if number > 1 else "the beginning"
        raise ConfigurationError(where, found, f"{previous}, the hash of {before}; one of the two was changed or moved")
