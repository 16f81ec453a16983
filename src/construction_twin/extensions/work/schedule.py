"""The order of a building model's tasks: which jobs there are for an arm, what each waits for, and what may start now.

A job is one element that a task without subtasks makes or works on; it is placed before anything works on it. An arm cannot end a
placing later than it is done, so what the end of a job waits for (``FINISH_FINISH``, ``START_FINISH``), its start waits for here. A
removal is one element that people take down. Times are arguments, in seconds of any one clock.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

from construction_twin.extensions.work.building import BuildingModel, Element, Sequence, Task
from construction_twin.extensions.work.errors import ScheduleError
from construction_twin.extensions.work.names import first_few
from construction_twin.extensions.work.process import DEFAULT, RECIPE, process_of
from construction_twin.extensions.work.proposed_schedule import in_order, propose
from construction_twin.extensions.work.wholes import parts_of, workpieces

#: Takes an element and a task; returns the process by which the task works on it.
ProcessOf = Callable[[Element, Task], str]


@dataclass(frozen=True)
class Wait:
    """What a job waits for: another one's end (`finished`) or start, and a `lag` since then [s]."""

    job: str
    finished: bool
    lag: float


@dataclass(frozen=True)
class Job:
    """One element to be placed, or worked on.

    Attributes:
        id: The task's GlobalId; of a task that makes several elements: with ``/1``, ``/2``, ... behind it.
        name: Where several jobs share the task's, the element's stands behind it: ``Panel up: stud 3``.
        robots: Who may do it; empty: any.
    """

    id: str
    task: str
    name: str
    element: str
    robots: tuple[str, ...]
    after: tuple[Wait, ...]
    process: str = DEFAULT

    @property
    def moves(self) -> bool:
        """Whether it takes the element from its stock to its place."""
        return process_of(self.process).moves


@dataclass(eq=False)
class Schedule:
    """A checked graph of jobs, made by `Schedule.of`.

    Attributes:
        jobs: In an order in which they can be done: as the tasks are scheduled if all say when, else as in the file.
        proposed: It, or a part of it, is a proposal from the geometry, which a person must accept.
        removals: Elements that people take down; what each waits for is in `after`.
    """

    jobs: tuple[Job, ...]
    notes: tuple[str, ...]
    proposed: bool = False
    removals: tuple[Job, ...] = ()

    @cached_property
    def placing(self) -> dict[str, str]:
        """Id of the job that places each element, of those that one does."""
        return {job.element: job.id for job in self.jobs if job.moves}

    @cached_property
    def _by_id(self) -> dict[str, Job]:
        return {job.id: job for job in (*self.jobs, *self.removals)}

    @classmethod
    def of(
        cls, model: BuildingModel, proposed: bool = False, process: ProcessOf = lambda element, task: DEFAULT
    ) -> Schedule:
        """Return the schedule of a model."""
        reading = _Reading(model, process)
        everything = reading.jobs()
        moments, note = _moments(everything, model)
        reading.notes += [note] if note and not proposed else []
        jobs: list[Job] = []
        removals: list[Job] = []
        # what is to be taken down without a task has no date and comes first
        places = {job.id: (moments.get(job.id, -math.inf), number) for number, job in enumerate(everything)}
        by_id = {job.id: job for job in everything}
        before = {job.id: [wait.job for wait in job.after] for job in everything}
        for name in in_order(before, lambda one: places[one]):
            (removals if name in reading.removals else jobs).append(by_id[name])
        return cls(tuple(jobs), tuple(reading.notes), proposed or reading.guessed, tuple(removals))

    def job(self, identifier: str) -> Job:
        """Return the job of that id."""
        if identifier not in self._by_id:
            raise ScheduleError(f"job {identifier!r}: the schedule has none of that id")
        return self._by_id[identifier]

    def waits_for(
        self, identifier: str, started: Mapping[str, float], finished: Mapping[str, float], now: float
    ) -> str:
        """Return the first thing that a job still waits for: ``after 'Place stud 1' (2xF...) has finished``; empty: it may start.

        `started`, `finished`: When [s], by job id; a job that is finished need not be in `started`.
        """
        for wait in self.job(identifier).after:
            since = finished.get(wait.job) if wait.finished else started.get(wait.job, finished.get(wait.job))
            if since is not None and since + wait.lag <= now:
                continue
            other = self.job(wait.job)
            after = f"after {other.name!r} ({other.id}) has {'finished' if wait.finished else 'started'}"
            return after if since is None else f"{since + wait.lag - now:.0f} s from now, its lag {after}"
        return ""


# -- from tasks to jobs ------------------------------------------------------------------------------------------------

#: What something waits for: lag by job and whether that must be finished.
_Waits = dict[tuple[str, bool], float]


class _Reading:
    """Tasks and sequences of one model, checked.

    Attributes:
        removals: Ids of what `jobs` returns for people to take down.
        guessed: A part of the order is proposed from the geometry.
    """

    def __init__(self, model: BuildingModel, process: ProcessOf):
        if not model.tasks:
            raise ScheduleError(
                f"{model.file}: it has no tasks; have an order proposed from the geometry and accept it"
            )
        self._model, self._tasks, self._elements, self._process_of = model, model.tasks, model.elements, process
        self.notes: list[str] = []
        self.removals: set[str] = set()
        self.guessed = False
        self._standing: set[str] = set()
        self._children: dict[str, list[str]] = {identifier: [] for identifier in model.tasks}
        for identifier, task in model.tasks.items():
            if task.parent:
                self._children[task.parent].append(identifier)
        try:
            TopologicalSorter(self._children).prepare()
        except CycleError as error:
            circle = ", ".join(dict.fromkeys(reversed(error.args[1])))
            raise ScheduleError(f"tasks nest in each other in a circle: {circle}") from error
        self._sequences = self._checked_sequences()
        self._products = self._checked_products()

    def jobs(self) -> tuple[Job, ...]:
        """Return jobs and removals in the file's order."""
        waits = self._all_waits()
        jobs: list[Job] = []
        for identifier, products in self._products.items():
            task, after, down = self._tasks[identifier], waits[identifier], self._is_removal(identifier)
            robots = next(filter(None, (self._tasks[at].robots for at in self._above(identifier))), ())
            for number, product in enumerate(products, 1):
                own = self._job_id(identifier, number)
                found = tuple(Wait(job, finished, lag) for (job, finished), lag in after.items())
                process = DEFAULT if down else self._process_of(self._elements[product], task)
                jobs.append(Job(own, identifier, task.name, product, () if down else robots, found, process))
                after = {(own, True): 0.0}
                self.removals |= {own} if down else set()
        jobs = self._with_distinct_names(jobs)
        taken_down = {job.element for job in jobs if job.id in self.removals}
        for element in self._elements.values():
            if element.status == "demolish" and element.bodies and element.id not in taken_down:
                own = f"{element.id}/removal"
                self.removals.add(own)
                jobs.append(Job(own, own, f"Take down {element.name or element.id}", element.id, (), ()))
        for job in jobs:
            if job.id in self.removals:
                remark = (
                    f"{job.element} is to be taken down ({job.name}): an obstacle until a person says that it is gone"
                )
                self.notes.append(f"{remark} (`twin work removed {job.id}`).")
        made = {job.element for job in jobs} | self._standing
        if left := [one for one in workpieces(self._model) if one not in made]:
            remark = f"No task makes {len(left)} of the elements: {first_few(left)}"
            self.notes.append(f"{remark}; the arm leaves them alone.")
        return tuple(jobs)

    def _with_distinct_names(self, jobs: list[Job]) -> list[Job]:
        """Return the jobs, those that share a name with their element's behind it."""
        shared = Counter(job.name for job in jobs)
        found = []
        for job in jobs:
            element = self._elements[job.element].name
            more = shared[job.name] > 1 and job.name and element and element not in job.name
            found.append(replace(job, name=f"{job.name}: {element}") if more else job)
        return found

    def _is_removal(self, identifier: str) -> bool:
        """Return whether a task removes what is assigned to it: by its kind, or because all of that is to be removed."""
        task = self._tasks[identifier]
        known = [self._elements[one] for one in task.products if one in self._elements]
        demolish = bool(known) and all(element.status == "demolish" for element in known)
        works = task.properties.get(RECIPE) is not None
        return task.kind == "takes_down" or (task.kind == "makes" and demolish and not works)

    def _moves(self, identifier: str, element: str) -> bool:
        """Return whether a task places an element, in place of working on it where it stands."""
        return process_of(self._process_of(self._elements[element], self._tasks[identifier])).moves

    def _is_completed(self, identifier: str) -> bool:
        return any(self._tasks[at].completed for at in self._above(identifier))

    def _job_id(self, task: str, number: int) -> str:
        return task if len(self._products[task]) == 1 else f"{task}/{number}"

    def _above(self, identifier: str) -> Iterator[str]:
        """Yield the task and those that it nests in, from inside."""
        while identifier:
            yield identifier
            identifier = self._tasks[identifier].parent

    def _with_parts(self, ids: Iterable[str]) -> dict[str, None]:
        """Return elements, each before its parts."""
        return dict.fromkeys(part for one in ids for part in (one, *parts_of(self._elements, one)))

    def _checked_sequences(self) -> dict[str, list[Sequence]]:
        """Return the sequences by the task that waits."""
        into: dict[str, list[Sequence]] = {identifier: [] for identifier in self._tasks}
        for sequence in self._model.sequences:
            ids = (sequence.before, sequence.after)
            called = f"sequence from {ids[0]} to {ids[1]}"
            if sequence.before in self._above(sequence.after) or sequence.after in self._above(sequence.before):
                if sequence.kind not in ("START_START", "FINISH_FINISH") or ids[0] == ids[1]:
                    why = "they are the same, or one nests in the other"
                    raise ScheduleError(f"the {called} makes a task wait for itself: {why}")
                self.notes.append(f"The {called} is left out: one of them nests in the other.")
                continue
            if sequence.lag < 0.0:
                said = f"The lead from {ids[0]} to {ids[1]} is not used"
                self.notes.append(f"{said}: the arm waits as if its lag were 0.")
            into[sequence.after].append(sequence)
        return into

    def _checked_products(self) -> dict[str, tuple[str, ...]]:
        """Return the elements that each task without subtasks makes, of those that make any."""
        found: dict[str, tuple[str, ...]] = {}
        maker: dict[str, str] = {}
        works: list[tuple[str, str]] = []
        idle: list[str] = []
        for identifier, task in self._tasks.items():
            given = (*task.products, *(task.inputs if task.kind == "takes_down" else ()))
            known = tuple(dict.fromkeys(one for one in given if one in self._elements))
            if self._children[identifier]:
                if known:
                    sentence = f"What task {identifier} makes is taken from the tasks that nest in it"
                    self.notes.append(f"{sentence}: {first_few(known)}.")
                continue
            if unknown := [one for one in task.products if one not in self._elements]:
                sentence = f"Task {identifier} makes {first_few(unknown)}, which the arm cannot place"
                self.notes.append(f"{sentence}: no such element was read.")
            known = self._to_do(identifier, known)
            if not known:
                if not task.milestone and task.kind == "makes" and not self._is_completed(identifier):
                    idle.append(identifier)
                continue
            for element in () if self._is_removal(identifier) else known:
                if not self._moves(identifier, element):
                    works.append((identifier, element))
                    continue
                if element in maker:
                    twice = f"element {element} ({self._elements[element].name!r}) is made twice"
                    raise ScheduleError(f"{twice}, by tasks {maker[element]} and {identifier}; it can be placed once")
                maker[element] = identifier
            found[identifier] = known
        for identifier, element in works:
            # it stands before anybody works on it, whether or not the file says so
            if element in maker:
                self._sequences[identifier].append(Sequence(maker[element], identifier))
        if idle:
            sentence = f"{len(idle)} {'tasks' if len(idle) > 1 else 'task'} without element: {first_few(idle)}"
            self.notes.append(f"{sentence}; kept for the order, no time is waited for.")
        return self._without_temporary(found, maker)

    def _to_do(self, identifier: str, known: tuple[str, ...]) -> tuple[str, ...]:
        """Return what is left for a task to place or to take down: what stands is not placed again."""
        elements = self._elements
        if self._is_removal(identifier):
            # what the file calls completed still stands here until a person says that it does not
            return tuple(one for one in self._with_parts(known) if elements[one].bodies)
        if self._tasks[identifier].kind != "makes":
            return ()
        if self._is_completed(identifier):
            self._standing |= self._with_parts(known).keys()
            return ()
        works = [one for one in known if elements[one].bodies and not self._moves(identifier, one)]
        there = [one for one in known if elements[one].status and one not in works]
        if there:
            self._standing |= set(there)
            said = f"Task {identifier} makes {first_few(there)}, which the model has as existing or to be taken down"
            self.notes.append(f"{said}: not placed.")
        found: list[str] = []
        for one in known:
            if one not in there:
                whole = one in works or elements[one].bodies or not parts_of(elements, one)
                found += [one] if whole else self._of_assembly(identifier, one)
        return tuple(dict.fromkeys(found))

    def _of_assembly(self, identifier: str, element: str) -> list[str]:
        """Return the workpieces of what has no body but parts or members that no other task makes, as proposed."""
        model, parts = self._model, set(parts_of(self._elements, element))
        # also the parts of an assembly within this one that has a task of its own, done or not
        elsewhere: set[str] = set()
        earlier = True
        for name, task in self._tasks.items():
            earlier = earlier and name != identifier
            for one in task.products if name != identifier and task.kind == "makes" else ():
                if one not in model.elements or not self._moves(name, one):
                    continue
                theirs = set(parts_of(self._elements, one))
                # of groups with something in common the smaller one has it, else the first
                if one in parts or (theirs & parts and (theirs < parts or (earlier and not theirs > parts))):
                    elsewhere |= {one, *theirs}
        wanted = [one for one in workpieces(model) if one in parts - elsewhere]
        sentence = "nothing that is in it is left for this task"
        if wanted:
            alone = replace(model, elements={one: model.elements[one] for one in wanted}, tasks={}, sequences=())
            wanted = [one for part in propose(alone).tasks.values() for one in part.products]
            self.guessed = self.guessed or len(wanted) > 1
            order = "one after the other, in an order from the geometry that a person must accept"
            sentence = f"what is in it is placed {order}: {first_few(wanted)}"
        assembly = f"Task {identifier} makes {model.elements[element].name or element}, which has no body of its own"
        self.notes.append(f"{assembly}: {sentence}.")
        return wanted

    def _without_temporary(
        self, found: dict[str, tuple[str, ...]], maker: Mapping[str, str]
    ) -> dict[str, tuple[str, ...]]:
        """Return what tasks make and take down, without removals of what another one places first: it does not stand yet."""
        removed: set[str] = set()
        left = {}
        for identifier, elements in found.items():
            left[identifier] = elements
            if not self._is_removal(identifier):
                continue
            if placed := [element for element in elements if element in maker]:
                said = f"Task {identifier} takes down {first_few(placed)}, which another task places: not read"
                self.notes.append(f"{said}, it stays; what comes after does not wait for it to be gone.")
            left[identifier] = tuple(element for element in elements if element not in {*placed, *removed})
            removed |= set(elements)
        return {identifier: elements for identifier, elements in left.items() if elements}

    def _all_waits(self) -> dict[str, _Waits]:
        """Return what the start of each task waits for, in terms of jobs.

        Two nodes per task: its start may come (0), and it is done (1). Order goes from a parent's start to its children's, from
        children to their parent's being done, along sequences from done to start, and through what makes nothing.
        """
        before: dict[tuple[str, int], list[tuple[str, int]]] = {}
        for identifier, task in self._tasks.items():
            start = [(sequence.before, 1) for sequence in self._sequences[identifier]]
            before[identifier, 0] = start + ([(task.parent, 0)] if task.parent else [])
            before[identifier, 1] = [(child, 1) for child in self._children[identifier]] or [(identifier, 0)]
        try:
            order = list(TopologicalSorter(before).static_order())
        except CycleError as error:
            circle = dict.fromkeys(identifier for identifier, _ in error.args[1])
            names = ", ".join(f"{identifier} ({self._tasks[identifier].name!r})" for identifier in circle)
            raise ScheduleError(f"tasks wait for each other in a circle: {names}") from error
        started: dict[str, _Waits] = {}
        finished: dict[str, _Waits] = {}
        gates: dict[str, _Waits] = {"": {}}
        for identifier, node in order:
            if node == 0:
                gates[identifier] = dict(gates[self._tasks[identifier].parent])
                for sequence in self._sequences[identifier]:
                    source = started if sequence.kind.startswith("START") else finished
                    _merge(gates[identifier], source[sequence.before], max(sequence.lag, 0.0))
            elif identifier in self._products:
                last = self._job_id(identifier, len(self._products[identifier]))
                started[identifier], finished[identifier] = {(last, False): 0.0}, {(last, True): 0.0}
            elif self._children[identifier]:
                started[identifier], finished[identifier] = {}, {}
                for child in self._children[identifier]:
                    _merge(started[identifier], started[child])
                    _merge(finished[identifier], finished[child])
            else:
                started[identifier] = finished[identifier] = gates[identifier]
        return gates


def _merge(waits: _Waits, more: _Waits, lag: float = 0.0) -> None:
    """Add what waits `lag` longer; the longest lag of each wins."""
    for wait, own in more.items():
        waits[wait] = max(own + lag, waits.get(wait, 0.0))


def _moments(jobs: tuple[Job, ...], model: BuildingModel) -> tuple[dict[str, float], str]:
    """Return the date of each job of a task, and a note; none where one is missing or they cannot be compared."""
    start_of = {job.id: model.tasks[job.task].start for job in jobs if job.task in model.tasks}
    dates = {one: datetime.fromisoformat(start) for one, start in start_of.items() if start}
    if dates and (missing := len(start_of) - len(dates)):
        return {}, f"Dates are not used for the order, because {missing} of {len(start_of)} jobs have none."
    if len({date.tzinfo is None for date in dates.values()}) > 1:
        return {}, "Dates are not used for the order, because some have a time zone and others none."
    if not dates and not model.sequences and len({job.task for job in jobs if job.id in start_of}) > 1:
        return {}, "The file says no order of its tasks, neither sequences nor dates: they come as they stand in it."
    return {one: date.timestamp() for one, date in dates.items()}, ""
