"""What the events of the ledger say: the state of every task, what is in the grip, what stands and what is open. One pure fold.

`fold` begins with no event, `Book.then` takes one more; a book is a value and never changes. Whoever wants another state adds an
event.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import LedgerError
from construction_twin.work.events import ACCEPTED, CHANGED, OF_NO_TASK, OPENED, Entry
from construction_twin.work.task_memory import TaskMemory
from construction_twin.work.task_states import SETTLED, UNDER_WAY, TaskEvent, TaskState

_FREED, _BLOCKED = Entry(TaskEvent.FREED.value), Entry(TaskEvent.BLOCKED.value)


@dataclass(frozen=True, eq=False)
class Book:
    """What is known after some events; made by `fold`.

    Attributes:
        after: Ids of the tasks that must be settled before each task, in the order in which they can be done.
        tasks: By id, in that order.
        accepted: Digest of the schedule that a person has accepted; empty: none.
        model, cell: SHA-256 of the model and path of the cell that were worked with last; empty: none yet.
        former: What is known of tasks that the schedule does not have any more.
        former_element: GlobalId of the element of each of these.
    """

    after: Mapping[str, tuple[str, ...]]
    tasks: Mapping[str, TaskMemory]
    accepted: str = ""
    model: str = ""
    cell: str = ""
    former: Mapping[str, TaskMemory] = field(default_factory=dict)
    former_element: Mapping[str, str] = field(default_factory=dict)

    def then(self, entry: Entry) -> Book:
        """Return what is known after one more event.

        Raises:
            NotNow: If it does not fit the states that the events before it left.
        """
        if entry.event == ACCEPTED:
            return replace(self, accepted=entry.schedule)
        if entry.event in (OPENED, CHANGED):
            return replace(self, model=entry.model, cell=entry.cell)
        if entry.event in OF_NO_TASK:
            return self
        if entry.task not in self.tasks:
            memory = _taken(self.former.get(entry.task, TaskMemory(entry.task)), entry)
            element = entry.element or self.former_element.get(entry.task, "")
            return replace(
                self,
                former={**self.former, entry.task: memory},
                former_element={**self.former_element, entry.task: element},
            )
        former_state, memory = self.tasks[entry.task].state, _taken(self.tasks[entry.task], entry)
        stays = memory.stays
        tasks = {**self.tasks, entry.task: memory}
        if memory.state is TaskState.READY or (memory.state in SETTLED) != (former_state in SETTLED):
            # only then somebody waits who did not, or waits no longer
            tasks = _settled(self.after, tasks)
        former = {
            # what is said now of where an element is replaces what was known of it by a task that is no more
            task: memory
            for task, memory in self.former.items()
            if not entry.element or self.former_element[task] != entry.element or stays
        }
        return replace(self, tasks=tasks, former=former)

    def check(self, entry: Entry) -> None:
        """Refuse what does not fit the present states, before it is written.

        Raises:
            LedgerError: If there is no such task.
            NotNow: If it does not fit the states.
        """
        if entry.event in OF_NO_TASK:
            return
        if entry.task not in self.tasks:
            raise LedgerError("ledger", Sentence("work.ledger.no_task", task=repr(entry.task), count=len(self.tasks)))
        self.tasks[entry.task].then(entry)

    # -- what is known

    def in_state(self, *states: TaskState) -> tuple[str, ...]:
        """Return the tasks in any of these states, in their order."""
        return tuple(name for name, memory in self.tasks.items() if memory.state in states)

    @property
    def busy(self) -> str:
        """The task that is under review or under way; empty: none."""
        return next(iter(self.in_state(TaskState.PLANNED, *UNDER_WAY)), "")

    @property
    def in_grip(self) -> tuple[str, ...]:
        """The tasks whose element is held by the tool, as far as is known."""
        return tuple(name for name, memory in self.tasks.items() if memory.in_grip)

    @property
    def standing(self) -> tuple[str, ...]:
        """The tasks whose element is placed."""
        return tuple(name for name, memory in self.tasks.items() if memory.placed)

    @property
    def open(self) -> tuple[str, ...]:
        """The tasks that are neither done nor skipped."""
        return tuple(name for name, memory in self.tasks.items() if memory.state not in SETTLED)

    def missing(self, task: str) -> tuple[str, ...]:
        """Return the predecessors that are neither done nor skipped."""
        return _missing(self.after, self.tasks, task)

    def followers(self, task: str) -> tuple[str, ...]:
        """Return the tasks that wait for this one and have begun or are done."""
        still = (TaskState.WAITING, TaskState.READY, TaskState.SKIPPED)
        return tuple(
            name for name, before in self.after.items() if task in before and self.tasks[name].state not in still
        )

    # -- another model or schedule

    @property
    def strange(self) -> tuple[str, ...]:
        """One sentence for each task which the schedule does not have any more."""
        return tuple(
            Sentence("work.strange", task=task, element=self.former_element[task], state=memory.state.value)
            for task, memory in self.former.items()
        )

    @property
    def left_behind(self) -> dict[str, TaskMemory]:
        """What is known of elements that were taken from their stock by such tasks, by GlobalId."""
        left = {task: memory for task, memory in self.former.items() if _touched(memory) and not memory.stays}
        return {self.former_element[task]: memory for task, memory in left.items()}

    def doubts(self, elements: Mapping[str, str], staying: Collection[str] = ()) -> list[Entry]:
        """Return the events by which a person is asked about all that was touched for another version of the model.

        Args:
            elements: GlobalId of the element of each task of the present schedule.
            staying: The tasks that leave it where it stands.
        """
        left, found = self.left_behind, []
        for task, memory in self.tasks.items():
            element = elements.get(task, "")
            if memory.state is TaskState.ASKS:
                continue
            if _touched(memory):
                # what is on its way out stands; only then can it be asked about
                times = 2 if memory.state is TaskState.RETREATING else 1
                found += [Entry("unknown", task, element, reason=Sentence("work.event.model_changed"))] * times
            elif element in left and memory.state in (TaskState.WAITING, TaskState.READY) and task not in staying:
                pose = left[element].base_T_element
                found.append(Entry("unknown", task, element, pose=pose, reason=Sentence("work.event.task_changed")))
        return found


def fold(after: Mapping[str, tuple[str, ...]], entries: Iterable[Entry] = ()) -> Book:
    """Return what is known after these events.

    Args:
        after: See `Book`.

    Raises:
        NotNow: If one does not fit the states that those before it left.
    """
    book = Book(dict(after), _settled(after, {task: TaskMemory(task) for task in after}))
    return functools.reduce(Book.then, entries, book)


def _taken(memory: TaskMemory, entry: Entry) -> TaskMemory:
    if memory.state is TaskState.WAITING and not memory.takes(entry):
        # what was done was done, even if a schedule that was changed since would have had it wait
        memory = memory.then(_FREED)
    return memory.then(entry)


def _missing(after: Mapping[str, tuple[str, ...]], tasks: Mapping[str, TaskMemory], task: str) -> tuple[str, ...]:
    return tuple(name for name in after[task] if name in tasks and tasks[name].state not in SETTLED)


def _settled(after: Mapping[str, tuple[str, ...]], tasks: Mapping[str, TaskMemory]) -> dict[str, TaskMemory]:
    """Return the tasks, those that wait for nobody free, and those that wait for others not."""
    settled = dict(tasks)
    for name, memory in tasks.items():
        if memory.state is TaskState.WAITING and not _missing(after, tasks, name):
            settled[name] = memory.then(_FREED)
        elif memory.state is TaskState.READY and _missing(after, tasks, name):
            settled[name] = memory.then(_BLOCKED)
    return settled


def _touched(memory: TaskMemory) -> bool:
    """Return whether an element may be elsewhere than in its stock, or is asked about."""
    doubtful = (TaskState.PLANNED, TaskState.ASKS, *UNDER_WAY)
    if memory.state is TaskState.DONE and memory.gone:
        # what was taken down is gone, whatever the model says since
        return False
    return memory.placed or memory.in_grip or memory.state is TaskState.DONE or memory.state in doubtful
