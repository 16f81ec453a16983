"""The ledger: one event per line, on the disk before anybody acts on it; the states of the tasks are computed from its lines.

One per robot and work cell; beside it the bodies that lines name by digest.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from construction_twin.core.append_only import AppendOnlyFile, read_lines
from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.files import write_atomically
from construction_twin.extensions.work.building import WorkError
from construction_twin.extensions.work.task_memory import (
    ACCEPTED,
    CHANGED,
    FROM_PLAN,
    MENDED,
    NOT_IN_MODEL,
    OF_NO_TASK,
    OPENED,
    SETTLED,
    UNDER_WAY,
    Entry,
    NotNow,
    TaskEvent,
    TaskMemory,
    TaskState,
    entry_of,
)
from construction_twin.scene.objects import SceneObject

_CHANGED_TASK = "the model was changed, and its task"
_FREED, _BLOCKED = Entry(TaskEvent.FREED.value), Entry(TaskEvent.BLOCKED.value)


class LedgerError(WorkError):
    """The ledger cannot be written or read, which stops the work."""

    def __init__(self, path: str, problem: str):
        super().__init__(f"{path}: {problem}")


@dataclass(frozen=True)
class ModelElement:
    """A task's element in the present model; `digest`: SHA-256, shape and place included; empty: no shape."""

    element: str
    digest: str = ""


@dataclass(frozen=True, eq=False)
class TaskStates:
    """The state of every task after some events; made by `replay`.

    Attributes:
        predecessors: The tasks that each task of the schedule waits for, in an order in which they can be done.
        tasks: In that order; behind them those of former schedules.
        elements: The element of each task of the schedule, where known.
        accepted: Digest of the accepted schedule.
        model, cell: The last SHA-256 and path.
    """

    predecessors: Mapping[str, tuple[str, ...]]
    tasks: Mapping[str, TaskMemory]
    elements: Mapping[str, str]
    accepted: str = ""
    model: str = ""
    cell: str = ""

    def with_entry(self, entry: Entry) -> TaskStates:
        """Return the states after one more event; raise NotNow if it does not fit."""
        if entry.event == ACCEPTED:
            return replace(self, accepted=entry.schedule)
        if entry.event in (OPENED, CHANGED):
            return replace(self, model=entry.model, cell=entry.cell)
        if entry.event in OF_NO_TASK:
            return self
        own = self.elements.get(entry.task, entry.element)
        # a task that was of another element is a former one's
        name = entry.task if entry.element in ("", own) else f"{entry.element} {entry.task}"
        before = self.tasks.get(name, TaskMemory(name))
        # what was done was done, even if a schedule that was changed since would have had it wait
        waits = before.state is TaskState.WAITING and not before.accepts(entry)
        memory = (before.with_entry(_FREED) if waits else before).with_entry(entry)
        tasks = {**self.tasks, name: memory}
        for task, other in self.tasks.items():
            # what is said now of where an element is replaces what was known of it by a task that is no more
            no_more = task not in self.predecessors and name in self.predecessors and not memory.stays
            if task == entry.former or (no_more and entry.element and other.element == entry.element):
                del tasks[task]
        if entry.former or memory.state is TaskState.READY or (memory.state in SETTLED) != (before.state in SETTLED):
            # only then somebody waits who did not, or waits no longer
            tasks = _settled(self.predecessors, tasks)
        return replace(self, tasks=tasks)

    def in_state(self, *states: TaskState) -> tuple[str, ...]:
        """Return the tasks in any of these states, in their order."""
        return tuple(name for name, memory in self.tasks.items() if memory.state in states)

    @property
    def busy(self) -> str:
        """The task that is under review or under way; empty: none."""
        return next(iter(self.in_state(TaskState.PLANNED, *UNDER_WAY)), "")

    @property
    def in_grip(self) -> tuple[str, ...]:
        """The tasks whose element is in the grip."""
        return tuple(name for name, memory in self.tasks.items() if memory.in_grip)

    @property
    def open(self) -> tuple[str, ...]:
        """The tasks of the schedule that are still open."""
        return tuple(name for name in self.predecessors if self.tasks[name].state not in SETTLED)

    @property
    def asking(self) -> tuple[str, ...]:
        """The tasks whose question is open."""
        return tuple(name for name in self.in_state(TaskState.ASKS) if name in self.predecessors or name in self.former)

    def missing(self, task: str) -> tuple[str, ...]:
        """Return the predecessors that are still open."""
        return _missing(self.predecessors, self.tasks, task)

    def followers(self, task: str) -> tuple[str, ...]:
        """Return the tasks that wait for this one and have begun or are done."""
        still = (TaskState.WAITING, TaskState.READY, TaskState.SKIPPED)
        return tuple(
            name for name, before in self.predecessors.items() if task in before and self.tasks[name].state not in still
        )

    @property
    def former(self) -> dict[str, TaskMemory]:
        """The tasks of former schedules that have taken an element from its stock."""
        return {
            task: memory
            for task, memory in self.tasks.items()
            if task not in self.predecessors and memory.touched and not memory.stays
        }

    def doubts(
        self,
        model: str,
        placing: Mapping[str, str],
        standing: Collection[str] = (),
        model_elements: Mapping[str, ModelElement] = MappingProxyType({}),
    ) -> list[Entry]:
        """Return the events by which a person is asked about what has changed since it was placed or answered."""
        found = []
        for task, memory in self.tasks.items():
            no_more, stands = task not in self.predecessors, memory.placed and memory.state in SETTLED
            if not memory.touched or (no_more and memory.stays):
                continue
            heir = placing.get(memory.element, "") if no_more else ""
            present = model_elements.get(heir or task)
            unchanged = stands and memory.seen == (NOT_IN_MODEL if present is None else present.digest)
            if heir and self.tasks[heir].state in (TaskState.WAITING, TaskState.READY):
                event = "same" if unchanged else "found" if memory.placed else "unknown"
                found.append(placed_elsewhere(event, heir, memory))
            elif memory.state is TaskState.ASKS or unchanged or (no_more and stands and memory.element in standing):
                continue
            elif self.model != model or (no_more and not stands):
                # what is on its way out stands; only then can it be asked about
                times = 2 if memory.state is TaskState.RETREATING else 1
                found += [Entry("unknown", task, memory.element, reason="the model was changed")] * times
        return found


def placed_elsewhere(event: str, task: str, memory: TaskMemory) -> Entry:
    """Return the event by which a task takes over an element of another one."""
    source = FROM_PLAN if event == TaskEvent.SAME.value and memory.as_planned else ""
    return Entry(
        event, task, memory.element, pose=memory.base_T_element, name=memory.name,
        body=memory.body, goal=memory.goal, seen=memory.seen, former=memory.task, reason=_CHANGED_TASK, source=source,
    )  # fmt: skip


def initial_states(predecessors: Mapping[str, tuple[str, ...]], elements: Mapping[str, str]) -> TaskStates:
    """Return the states before any event."""
    return TaskStates(predecessors, _settled(predecessors, {task: TaskMemory(task) for task in predecessors}), elements)


def _missing(predecessors: Mapping[str, Sequence[str]], tasks: Mapping[str, TaskMemory], task: str) -> tuple[str, ...]:
    return tuple(name for name in predecessors.get(task, ()) if name in tasks and tasks[name].state not in SETTLED)


def _settled(predecessors: Mapping[str, tuple[str, ...]], tasks: Mapping[str, TaskMemory]) -> dict[str, TaskMemory]:
    settled = dict(tasks)
    for name, memory in tasks.items():
        if memory.state is TaskState.WAITING and not _missing(predecessors, tasks, name):
            settled[name] = memory.with_entry(_FREED)
        elif memory.state is TaskState.READY and _missing(predecessors, tasks, name):
            settled[name] = memory.with_entry(_BLOCKED)
    return settled


class Ledger:
    """The file and the states of its tasks. `clock`: Returns the time since 1970 [ns]; other arguments as of `TaskStates`."""

    def __init__(
        self,
        path: str | Path,
        predecessors: Mapping[str, tuple[str, ...]],
        model: str,
        clock: Callable[[], int],
        cell: str = "",
        placing: Mapping[str, str] = MappingProxyType({}),
        standing: Collection[str] = (),
        robot: str = "",
        model_elements: Mapping[str, ModelElement] = MappingProxyType({}),
    ):
        self.path = Path(path)
        self._bodies = self.path.parent / "standing"
        self._clock = clock
        self._file = AppendOnlyFile(self.path, LedgerError, "work node")
        try:
            self.states = replay(self.path, predecessors, {task: each.element for task, each in model_elements.items()})
            if self._file.lines == 0:
                self.add(Entry(OPENED, model=model, cell=cell, robot=robot))
            if self._file.cut_off:
                self.add(Entry(MENDED, reason=f"{self._file.cut_off} bytes of a line without its end were cut off"))
            for entry in self.states.doubts(model, placing, standing, model_elements):
                self.add(entry)
            # last: killed before it, the next start asks again
            if (self.states.model, self.states.cell) != (model, cell):
                self.add(Entry(CHANGED, model=model, cell=cell))
        except ConstructionTwinError:
            self._file.close()
            raise

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self._file.lines

    def add(self, entry: Entry) -> None:
        """Write an event to the disk; where this raises NotNow or LedgerError nothing is written."""
        now = self._clock()
        entry = replace(entry, time_ns=now)
        if entry.event not in OF_NO_TASK:
            # a replay is lenient: what is written must be an event of its task's state
            self.states.tasks.get(entry.task, TaskMemory(entry.task)).with_entry(entry)
        states = self.states.with_entry(entry)
        self._file.append(now, entry.fields())
        self.states = states

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def save_bodies(self, bodies: Sequence[SceneObject]) -> str:
        """Save an element's pieces; return their digest."""
        digest = bodies_digest(bodies)
        try:
            for item in bodies:
                if item.mesh:
                    self._write(_mesh_name(item), Path(item.mesh).read_bytes())
            self._write(f"{digest}.json", _contents(bodies))
        except OSError as error:
            raise LedgerError(str(self._bodies), str(error)) from error
        return digest

    def _write(self, name: str, contents: bytes) -> None:
        path = self._bodies / name
        if path.exists() and path.read_bytes() == contents:
            return
        write_atomically(path, contents)
        for each in (path, self._bodies, self._bodies.parent):
            handle = os.open(each, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)

    def saved_bodies(self, element: str, digest: str) -> tuple[SceneObject, ...]:
        """Read saved pieces as ``<element>/0``, ..., in the element's frame."""
        path = self._bodies / f"{digest}.json"
        try:
            content, pieces = path.read_bytes(), []
            changed = hashlib.sha256(content).hexdigest() != digest
            for number, piece in enumerate([] if changed else json.loads(content)):
                piece["mesh"] = piece["mesh"] and str(self._bodies / piece["mesh"])
                pieces.append(SceneObject(f"{element}/{number}", **piece))
            if changed or any(item.mesh and item.mesh_digest != Path(item.mesh).stem for item in pieces):
                raise ValueError("it is not what it was when it was written; restore the folder")
        except (OSError, ValueError, ConstructionTwinError) as error:
            raise LedgerError(str(path), str(error)) from error
        return tuple(pieces)


#: Kept of each piece, besides its mesh.
_OF_BODY = ("shape", "size", "position", "quaternion", "padding")


def bodies_digest(bodies: Sequence[SceneObject]) -> str:
    """Return the digest under which an element's pieces are saved."""
    return hashlib.sha256(_contents(bodies)).hexdigest()


def _contents(bodies: Sequence[SceneObject]) -> bytes:
    each = [{**{key: getattr(item, key) for key in _OF_BODY}, "mesh": _mesh_name(item)} for item in bodies]
    return json.dumps(each).encode()


def _mesh_name(item: SceneObject) -> str:
    return f"{item.mesh_digest}{Path(item.mesh).suffix}" if item.mesh else ""


def replay(path: Path, predecessors: Mapping[str, tuple[str, ...]], elements: Mapping[str, str]) -> TaskStates:
    """Return the states after all lines."""
    states = initial_states(predecessors, elements)
    for number, entry in enumerate(read_entries(path), start=1):
        if number == 1 and entry.event != OPENED:
            raise LedgerError(str(path), f"line 1 is {entry.event!r}; expected {OPENED!r}: this is no ledger")
        try:
            states = states.with_entry(entry)
        except NotNow as error:
            raise LedgerError(str(path), f"line {number}: {error}") from error
    return states


def read_entries(path: Path) -> Iterator[Entry]:
    """Read the lines of a ledger."""
    for number, fields in enumerate(read_lines(path), start=1):
        try:
            yield entry_of(fields)
        except (ValueError, TypeError, AttributeError) as error:
            raise LedgerError(str(path), f"line {number} is none of a ledger: {error}") from error
