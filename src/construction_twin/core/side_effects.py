"""Reports and records beside a safety act, whose failure leaves the act alone.

A safety act (stop, stop_plan, pause, halt, reject) is carried out and answered whatever fails here, and never runs here.
"""

from __future__ import annotations

import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

#: Failures that wait for the log; of more the oldest are dropped. All of them are counted.
MAX_UNWRITTEN = 20
#: What is quoted of an exception [characters].
_LONGEST = 300

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Failure:
    """A failure beside an act."""

    what: str
    error: Exception

    @property
    def sentence(self) -> str:
        """What failed, where and how, in one sentence; reads no source file."""
        frame = self.error.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        where = f" in {frame.tb_frame.f_code.co_name}, line {frame.tb_lineno}" if frame is not None else ""
        # unlike str(), this does not fail with the exception's own text
        text = traceback.format_exception_only(self.error)[-1].strip()[:_LONGEST]
        return f"{self.what} failed beside an act that was carried out{where}: {text}"

    @property
    def trace(self) -> str:
        """The traceback, which reads source files (background thread only)."""
        return "".join(traceback.format_exception(self.error))


class SideEffects:
    """Runs parts that may fail, and counts their failures. Thread-safe, without waiting."""

    def __init__(self):
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._unwritten: deque[Failure] = deque(maxlen=MAX_UNWRITTEN)
        self._last = ""

    def run(self, what: str, part: Callable[..., _Result], *arguments: object) -> _Result | None:
        """Run a part and return its result; None after an unexpected exception, which is counted by `what`."""
        try:
            return part(*arguments)
        except Exception as error:  # noqa: BLE001 (beside an act nothing may fail; each is counted)
            failure = Failure(what, error)
            with self._lock:
                self._counts[what] += 1
                self._unwritten.append(failure)
                self._last = failure.sentence
            return None

    def pop_failures(self) -> list[Failure]:
        """Return the failures since the last call, oldest first, for a log."""
        with self._lock:
            failures = list(self._unwritten)
            self._unwritten.clear()
        return failures

    @property
    def unwritten(self) -> bool:
        """Whether failures wait for the log."""
        return bool(self._unwritten)

    def write(self, log: Callable[[str, str], object], failures: list[Failure] | None = None) -> None:
        """Write failures, by default those of `pop_failures`, to a log as `rospy.logerr` (background thread only)."""
        failures = self.pop_failures() if failures is None else failures
        for failure in failures:
            self.run("the log", log, "%s", f"{failure.sentence}\n{failure.trace}")
        if failures:
            with self._lock:
                # otherwise a log that fails would be logged again and again
                self._unwritten = deque(
                    (each for each in self._unwritten if each.what != "the log"), maxlen=MAX_UNWRITTEN
                )

    @property
    def sentence(self) -> str:
        """The last failure, with how many there were, and what to do; "" while there was none."""
        with self._lock:
            total, last = self._counts.total(), self._last
        return f"{last} ({total} so far); restart this node when the arm is at rest, and report it" if total else ""

    def counts(self, prefix: str = "") -> dict[str, int]:
        """Return how often each part failed, by its name; with a prefix in one word, as a counter of the gateway's status."""
        with self._lock:
            counts = sorted(self._counts.items())
        if not prefix:
            return dict(counts)
        return {f"{prefix}_{what.replace(' ', '_')}": count for what, count in counts}

    def status_fields(self) -> dict[str, object]:
        """Return the values for `/diagnostics`; empty while nothing has failed."""
        counts = self.counts()
        if not counts:
            return {}
        return {f"failed beside an act: {what}": count for what, count in counts.items()} | {
            "last failure beside an act": self._last
        }
