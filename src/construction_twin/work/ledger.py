"""The ledger: what was done of a building model, one line per step, on the disk before anybody acts on it.

A chained file (`review.chained_file`), one per robot and name of the model. Replaying it gives the state of every task, so that a
node that was killed at any instant comes back with what is true. Its file is the only memory. When the model has changed since, a
person is asked about everything that was touched. Metres; poses as x, y, z and quaternion x, y, z, w.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.work_errors import LedgerError
from construction_twin.review.chained_file import ChainedFile, read_whole
from construction_twin.work.task_states import (
    SETTLED,
    UNDER_WAY,
    NotNow,
    TaskEvent,
    TaskMemory,
    TaskOccasion,
    TaskState,
)

#: Lines that are about no task.
OPENED, ACCEPTED, MENDED, CHANGED = "opened", "accept_schedule", "mended", "changed"
_OF_NO_TASK = (OPENED, ACCEPTED, MENDED, CHANGED)
#: Where the pose of an element that was let go comes from.
MEASURED, PLANNED = "measured", "planned"
_MODEL_CHANGED = "the model was changed"
#: Largest ledger that is read [bytes].
LARGEST = 256 * 2**20


@dataclass(frozen=True)
class Entry:
    """One line of the ledger.

    Attributes:
        event: A `TaskEvent`'s word, or `OPENED`, `ACCEPTED`, `MENDED`, `CHANGED`.
        task, element: GlobalIds; empty where it is about neither.
        source: Of the pose of `released`: `MEASURED` by the arm's own feedback, or `PLANNED`: as planned, not measured.
        plan, offer, grip: `offer` is named in the plan's `source`, so that a plan whose id was never learnt is known again.
        pose: Length 7 or 0
        model, cell, schedule: SHA-256 of the model's file; path of the cell file; SHA-256 of the schedule that was accepted.
        time_ns: When it was written, since 1970 [ns].
    """

    event: str
    task: str = ""
    element: str = ""
    plan: str = ""
    offer: str = ""
    grip: str = ""
    pose: tuple[float, ...] = ()
    source: str = ""
    answer: str = ""
    person: str = ""
    reason: str = ""
    model: str = ""
    cell: str = ""
    schedule: str = ""
    time_ns: int = 0

    @property
    def said(self) -> TaskOccasion:
        """What of it concerns the task's state."""
        return TaskOccasion(
            self.reason,
            self.time_ns,
            self.answer,
            self.plan,
            self.offer,
            self.grip,
            self.pose,
            self.person,
            self.source,
        )

    def fields(self) -> dict:
        """Return what is written of it: all that is not empty."""
        return {name: value for name, value in asdict(self).items() if value and name != "time_ns"}


class Book:
    """The state of every task, as the lines read so far tell it.

    Args:
        after: Ids of the tasks that must be settled before each task, in the order in which they can be done.

    Attributes:
        accepted: Digest of the schedule that a person has accepted; empty: none.
        model, cell: SHA-256 of the model and path of the cell that were worked with last; empty: none yet.
        former: What is known of tasks that the schedule does not have any more.
    """

    def __init__(self, after: Mapping[str, tuple[str, ...]]):
        self._after = dict(after)
        self.tasks = {task: TaskMemory(task) for task in self._after}
        self.accepted = self.model = self.cell = ""
        self.former: dict[str, TaskMemory] = {}
        self._element_of: dict[str, str] = {}
        self._settle()

    @property
    def strange(self) -> tuple[str, ...]:
        """One sentence for each task which the schedule does not have any more."""
        return tuple(
            f"the ledger has task {task} of element {self._element_of[task]} as {memory.state.value}, "
            "which the schedule does not have any more"
            for task, memory in self.former.items()
        )

    @property
    def left_behind(self) -> dict[str, TaskMemory]:
        """What is known of elements that were taken from their stock by such tasks, by GlobalId."""
        return {self._element_of[task]: memory for task, memory in self.former.items() if _touched(memory)}

    def doubts(self, elements: Mapping[str, str]) -> list[Entry]:
        """Return the lines by which a person is asked about all that was touched for another version of the model.

        Args:
            elements: GlobalId of the element that each task of the present schedule places.
        """
        left, found = self.left_behind, []
        for task, memory in self.tasks.items():
            element = elements.get(task, "")
            if memory.state is TaskState.ASKS:
                continue
            if _touched(memory):
                # what is on its way out stands; only then can it be asked about
                times = 2 if memory.state is TaskState.RETREATING else 1
                found += [Entry("unknown", task, element, reason=_MODEL_CHANGED)] * times
            elif element in left and memory.state in (TaskState.WAITING, TaskState.READY):
                pose = left[element].base_T_element
                found.append(Entry("unknown", task, element, pose=pose, reason=f"{_MODEL_CHANGED}, and its task"))
        return found

    def missing(self, task: str) -> tuple[str, ...]:
        """Return the predecessors that are neither done nor skipped."""
        return tuple(name for name in self._after[task] if name in self.tasks and not self._is_settled(name))

    def followers(self, task: str) -> tuple[str, ...]:
        """Return the tasks that wait for this one and have begun or are done."""
        still = (TaskState.WAITING, TaskState.READY, TaskState.SKIPPED)
        return tuple(
            name for name, before in self._after.items() if task in before and self.tasks[name].state not in still
        )

    def check(self, entry: Entry) -> None:
        """Refuse what does not fit the present states, before it is written.

        Raises:
            LedgerError: If there is no such task.
            NotNow: If it does not fit the states.
        """
        if entry.event in _OF_NO_TASK:
            return
        event = TaskEvent(entry.event)
        if entry.task not in self.tasks:
            raise LedgerError("ledger", f"no task {entry.task!r}; expected one of the schedule's {len(self.tasks)}")
        memory = self.tasks[entry.task]
        if not memory.takes(event, entry.answer):
            raise NotNow(entry.task, memory.state, event)

    def take(self, entry: Entry) -> None:
        """Take one line.

        Raises:
            NotNow: If it does not fit the states that the lines before it left.
        """
        if entry.event == ACCEPTED:
            self.accepted = entry.schedule
        if entry.event in (OPENED, CHANGED):
            self.model, self.cell = entry.model, entry.cell
        if entry.event in _OF_NO_TASK:
            return
        if entry.task in self.tasks:
            memory = self.tasks[entry.task]
            # what is said of an element now replaces what was known of it by a task that is no more
            same = [task for task in self.former if entry.element and self._element_of[task] == entry.element]
            for task in same:
                del self.former[task]
        else:
            memory = self.former.setdefault(entry.task, TaskMemory(entry.task))
            self._element_of[entry.task] = entry.element or self._element_of.get(entry.task, "")
        event = TaskEvent(entry.event)
        if memory.state is TaskState.WAITING and not memory.takes(event, entry.answer):
            # what was done was done, even if a schedule that was changed since would have had it wait
            memory.apply(TaskEvent.FREED)
        memory.apply(event, entry.said)
        self._settle()

    def in_state(self, *states: TaskState) -> tuple[str, ...]:
        """Return the tasks in any of these states, in their order."""
        return tuple(name for name, memory in self.tasks.items() if memory.state in states)

    def _is_settled(self, task: str) -> bool:
        return self.tasks[task].state in SETTLED

    def _settle(self) -> None:
        for name, memory in self.tasks.items():
            if memory.state is TaskState.WAITING and not self.missing(name):
                memory.apply(TaskEvent.FREED)
            elif memory.state is TaskState.READY and self.missing(name):
                memory.apply(TaskEvent.BLOCKED)


class Ledger:
    """The file and the book that follows from it. Not for several threads at once.

    Args:
        after: See `Book`.
        model: SHA-256 of the model's file.
        clock: Returns the time since 1970 in UTC [ns].
        cell: Path of the cell file, for the record.
        elements: GlobalId of the element that each task places.

    Raises:
        LedgerError: If the file cannot be read or written, or a line of it cannot be true.
    """

    def __init__(
        self,
        path: str | Path,
        after: Mapping[str, tuple[str, ...]],
        model: str,
        clock: Callable[[], int],
        cell: str = "",
        elements: Mapping[str, str] | None = None,
    ):
        self.path = Path(path)
        self._clock = clock
        try:
            # read in full before every use: a ledger of this size is no ledger
            if self.path.exists() and self.path.stat().st_size > LARGEST:
                raise LedgerError(str(path), f"larger than {LARGEST / 2**20:g} MiB; move it away")
            self._file = ChainedFile(self.path, LedgerError, "work node", mend=True)
        except (ConfigurationError, OSError) as error:
            raise LedgerError(str(path), str(error).removeprefix(f"{path}: ")) from error
        try:
            self.book = replay(self.path, after)
            if self._file.state.lines == 0:
                self.add(Entry(OPENED, model=model, cell=cell))
            if self._file.mended:
                self.add(Entry(MENDED, reason=f"{self._file.mended} bytes of a line without its end were cut off"))
            if self.book.model != model:
                for entry in self.book.doubts(elements or {}):
                    self.add(entry)
            # last: killed before it, the next start asks again
            if (self.book.model, self.book.cell) != (model, cell):
                self.add(Entry(CHANGED, model=model, cell=cell))
        except ConstructionTwinError:
            self._file.close()
            raise

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self._file.state.lines

    @property
    def head(self) -> str:
        """SHA-256 of the last line."""
        return self._file.state.head

    def add(self, entry: Entry) -> None:
        """Write a line, then take it; when this returns it is on the disk.

        Raises:
            NotNow: If it does not fit; nothing is written.
            LedgerError: If it cannot be written; nothing is taken.
        """
        self.book.check(entry)
        now = self._clock()
        self._file.append(now, entry.fields())
        self.book.take(replace(entry, time_ns=now))

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def _touched(memory: TaskMemory) -> bool:
    """Return whether an element may be elsewhere than in its stock, or is asked about."""
    doubtful = (TaskState.PLANNED, TaskState.ASKS, *UNDER_WAY)
    if memory.state is TaskState.DONE and memory.gone:
        # what was taken down is gone, whatever the model says since
        return False
    return memory.placed or memory.in_grip or memory.state is TaskState.DONE or memory.state in doubtful


def replay(path: Path, after: Mapping[str, tuple[str, ...]]) -> Book:
    """Return the book that the lines of a ledger leave.

    Raises:
        LedgerError: Naming the line.
    """
    book = Book(after)
    for number, entry in enumerate(read_entries(path), start=1):
        if number == 1 and entry.event != OPENED:
            raise LedgerError(str(path), f"line 1 is {entry.event!r}; expected {OPENED!r}: this is no ledger")
        try:
            book.take(entry)
        except NotNow as error:
            raise LedgerError(str(path), f"line {number}: {error}") from error
    return book


def read_entries(path: Path) -> Iterator[Entry]:
    """Read the lines of a ledger; the chain is checked elsewhere.

    Raises:
        LedgerError: Naming the line that is none of a ledger.
    """
    try:
        content = read_whole(path)
    except ConfigurationError as error:
        raise LedgerError(str(path), "cannot be read") from error
    for number, line in enumerate(content.splitlines(), start=1):
        try:
            yield _entry(json.loads(line))
        except (ValueError, TypeError, AttributeError) as error:
            raise LedgerError(str(path), f"line {number} is none of a ledger: {error}") from error


def _entry(fields: dict) -> Entry:
    known = {name: value for name, value in fields.items() if name not in ("time", "previous")}
    pose = tuple(map(float, known.pop("pose", ())))
    if len(pose) not in (0, 7) or not all(map(math.isfinite, pose)):
        raise ValueError(f"a pose of {pose}; expected seven finite numbers")
    time_ns = int(known.pop("time_ns", 0))
    if not all(isinstance(value, str) for value in known.values()):
        raise ValueError("expected texts")
    event = known.get("event", "")
    if event not in _OF_NO_TASK:
        TaskEvent(event)
    return Entry(**known, pose=pose, time_ns=time_ns)
